// What will happen, in the order of time; at the same moment, in the order in which it was asked for.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <utility>

#include "firmware/sim/time.h"

namespace air {

class Events {
 public:
  using Id = std::pair<Femto, std::uint64_t>;

  Femto now() const { return now_; }

  // Of what comes next; `never` where nothing does.
  Femto next(Femto never) const { return queue_.empty() ? never : queue_.begin()->first.first; }

  Id at(Femto t, std::function<void()> what);  // not before now
  void cancel(Id id);                          // nothing where that has happened already

  // Everything until t, t included; now is t afterwards.
  void run_until(Femto t);

  // Moves on to t, before which nothing must be due.
  void advance(Femto t);

 private:
  Femto now_ = 0;
  std::uint64_t asked_ = 0;
  std::map<Id, std::function<void()>> queue_;
};

}  // namespace air
