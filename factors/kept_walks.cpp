#include "factors/kept_walks.h"

namespace synchronizar {

namespace {

// Each kept row's index among the kept, in the order of the whole.
void renumber(const std::vector<int>& kept, Numbers& renumbered) {
  for (size_t n = 0; n < kept.size(); ++n) renumbered[kept[n]] = static_cast<int>(n);
}

}  // namespace

KeptRows kept_rows(const Walks& walks, const Marks& kept) {
  KeptRows out;
  for (int u = 0; u < walks.users; ++u) {
    const auto begin = static_cast<int>(out.keyframes.size());
    for (int n = walks.first[u]; n < walks.first[u + 1]; ++n) {
      if (kept[n]) out.keyframes.push_back(n);
    }
    if (static_cast<int>(out.keyframes.size()) == begin) continue;
    if (u == walks.reference) out.reference = static_cast<int>(out.users.size());
    out.users.push_back(u);
    out.first.push_back(begin);
  }
  out.first.push_back(static_cast<int>(out.keyframes.size()));
  out.new_keyframe = Numbers::Constant(kept.size(), -1);
  renumber(out.keyframes, out.new_keyframe);
  for (int n = 0; n < walks.measured.size(); ++n) {
    if (kept[walks.keyframe_i[n]] && kept[walks.keyframe_j[n]]) out.ranges.push_back(n);
  }
  out.new_lasting = Numbers::Constant(walks.follows.size(), -1);
  if (walks.lasting.size() == 0) return out;
  Marks had = Marks::Constant(walks.follows.size(), false);
  for (const int n : out.ranges) had[walks.lasting[n]] = true;
  for (int v = 0; v < had.size(); ++v) {
    if (had[v]) out.lasting.push_back(v);
  }
  renumber(out.lasting, out.new_lasting);
  return out;
}

Walks kept_walks(const Walks& walks, const KeptRows& rows) {
  const auto all = Eigen::all;
  const auto antennas = [&](const Antennas& a) {
    return Antennas{a.offset(rows.ranges, all), a.lever(rows.ranges, all), a.velocity(rows.ranges, all)};
  };
  Walks out{};
  out.users = static_cast<int>(rows.users.size());
  out.reference = rows.reference;
  out.first = Eigen::Map<const Numbers>(rows.first.data(), static_cast<Eigen::Index>(rows.first.size()));
  out.t = walks.t(rows.keyframes);
  out.slam = walks.slam(rows.keyframes, all);
  out.keyframe_i = rows.new_keyframe(Numbers(walks.keyframe_i(rows.ranges)));
  out.keyframe_j = rows.new_keyframe(Numbers(walks.keyframe_j(rows.ranges)));
  out.i = antennas(walks.i);
  out.j = antennas(walks.j);
  out.measured = walks.measured(rows.ranges);
  out.sigma = walks.sigma(rows.ranges);
  if (walks.lasting.size() == 0) return out;
  out.lasting = rows.new_lasting(Numbers(walks.lasting(rows.ranges)));
  out.follows = walks.follows(rows.lasting);
  out.decay = walks.decay(rows.lasting);
  for (Eigen::Index v = 0; v < out.follows.size(); ++v) {
    if (out.follows[v] >= 0) out.follows[v] = rows.new_lasting[out.follows[v]];
    if (out.follows[v] < 0) out.decay[v] = 0.0;
  }
  return out;
}

WalkStates kept_states(const WalkStates& states, const KeptRows& rows) {
  return {states.places(rows.keyframes, Eigen::all), states.calibration(rows.users, Eigen::all),
          states.lasting(rows.lasting)};
}

WalkNoise kept_noise(const WalkNoise& noise, const KeptRows& rows, const Walks& its_walks,
                     const WalkStates& its_states) {
  const auto all = Eigen::all;
  WalkNoise out = noise;
  out.nlos_odds = noise.nlos_odds(rows.ranges);
  out.range_weight = noise.range_weight(rows.ranges);
  out.step_sigma = noise.step_sigma(rows.keyframes, all);
  out.level_information = noise.level_information(rows.keyframes);
  out.about.resize(its_walks.users, 4);
  for (int u = 0; u < its_walks.users; ++u) {
    const int whole = rows.users[static_cast<size_t>(u)];
    if (noise.surveyed[whole]) {
      out.about.row(u) = noise.about.row(whole);
    } else {
      out.about.row(u) = its_states.places.row(its_walks.first[u]);
    }
  }
  out.place_sigma = noise.place_sigma(rows.users);
  out.height_sigma = noise.height_sigma(rows.users);
  out.surveyed = noise.surveyed(rows.users);
  out.known_bias_sigma = noise.known_bias_sigma(rows.users);
  out.device_sigma = noise.device_sigma(rows.users, all);
  out.assumed_clock = noise.assumed_clock(rows.users);
  out.lasting_sigma = noise.lasting_sigma(rows.lasting);
  return out;
}

}  // namespace synchronizar
