#include "factors/by_serial.h"

namespace synchronizar {

FoundRows rows_by_serial(const Numbers& serial, const std::vector<SerialRows>& tables,
                         const Column& unknown) {
  FoundRows out{decltype(FoundRows::known)::Constant(serial.size(), false),
                unknown.transpose().replicate(serial.size(), 1)};
  if (serial.size() == 0) return out;
  const int first = serial.minCoeff();
  Numbers place = Numbers::Constant(serial.maxCoeff() - first + 1, -1);
  for (Eigen::Index n = 0; n < serial.size(); ++n) place[serial[n] - first] = static_cast<int>(n);
  for (const SerialRows& table : tables) {
    for (Eigen::Index n = 0; n < table.serial.size(); ++n) {
      const int at = table.serial[n] - first;
      if (at < 0 || at >= place.size() || place[at] < 0) continue;
      out.known[place[at]] = true;
      out.values.row(place[at]) = table.values.row(n);
    }
  }
  return out;
}

}  // namespace synchronizar
