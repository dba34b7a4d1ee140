#include "firmware/sim/events.h"

#include <stdexcept>

namespace air {

Events::Id Events::at(Femto t, std::function<void()> what) {
  if (t < now_) throw std::logic_error("an event was asked for in the past");
  const Id id{t, asked_++};
  queue_.emplace_hint(queue_.end(), id, std::move(what));
  return id;
}

void Events::cancel(Id id) { queue_.erase(id); }

void Events::run_until(Femto t) {
  while (!queue_.empty() && queue_.begin()->first.first <= t) {
    const auto due = queue_.extract(queue_.begin());  // it may ask for others, or cancel them
    now_ = due.key().first;
    due.mapped()();
  }
  advance(t);
}

void Events::advance(Femto t) {
  if (t < now_) throw std::logic_error("time was to go back");
  if (next(t) < t) throw std::logic_error("an event was to be passed over");
  now_ = t;
}

}  // namespace air
