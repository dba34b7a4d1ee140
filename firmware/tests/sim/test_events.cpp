// Order and time of simulated events.
#include <stdexcept>
#include <string>

#include "firmware/sim/events.h"
#include "tests/cpp/check.h"

namespace {

template <typename F>
bool throws(F f) {
  try {
    f();
  } catch (const std::logic_error&) {
    return true;
  }
  return false;
}

void events_happen_in_the_order_of_time_and_then_of_asking() {
  air::Events events;
  std::string said;
  events.at(20, [&] { said += 'c'; });
  events.at(10, [&] { said += 'a'; });
  events.at(20, [&] { said += 'd'; });
  events.at(15, [&] { said += 'b'; });
  events.at(31, [&] { said += 'z'; });
  events.run_until(30);
  CHECK(said == "abcd");
  CHECK(events.now() == 30);
  CHECK(events.next(99) == 31);
}

void an_event_sees_its_own_moment_and_may_ask_for_more_at_once() {
  air::Events events;
  air::Femto seen = -1, again = -1;
  events.at(7, [&] {
    seen = events.now();
    events.at(7, [&] { again = events.now(); });
  });
  events.run_until(7);
  CHECK(seen == 7 && again == 7);
}

void a_cancelled_event_does_not_happen_and_cancelling_late_does_nothing() {
  air::Events events;
  int happened = 0;
  const auto first = events.at(5, [&] { ++happened; });
  const auto second = events.at(5, [&] { ++happened; });
  events.cancel(second);
  events.run_until(6);
  events.cancel(first);
  CHECK(happened == 1);
  CHECK(events.next(-1) == -1);
}

void an_event_may_cancel_the_next_one_of_its_moment() {
  air::Events events;
  bool happened = false;
  air::Events::Id next;
  events.at(5, [&] { events.cancel(next); });
  next = events.at(5, [&] { happened = true; });
  events.run_until(5);
  CHECK(!happened);
}

void nothing_can_be_asked_for_in_the_past_nor_passed_over() {
  air::Events events;
  events.run_until(10);
  CHECK(throws([&] { events.at(9, [] {}); }));
  CHECK(throws([&] { events.advance(9); }));
  events.at(12, [] {});
  CHECK(throws([&] { events.advance(13); }));
  CHECK(events.now() == 10);
  events.advance(12);
  CHECK(events.now() == 12);
}

void a_moment_days_away_is_still_exact() {
  air::Events events;
  const air::Femto far = 1'000'000 * air::kSecond + 1;
  air::Femto seen = 0;
  events.at(far, [&] { seen = events.now(); });
  events.run_until(far - 1);
  CHECK(seen == 0);
  events.run_until(far);
  CHECK(seen == far);
}

}  // namespace

int main() {
  events_happen_in_the_order_of_time_and_then_of_asking();
  an_event_sees_its_own_moment_and_may_ask_for_more_at_once();
  a_cancelled_event_does_not_happen_and_cancelling_late_does_nothing();
  an_event_may_cancel_the_next_one_of_its_moment();
  nothing_can_be_asked_for_in_the_past_nor_passed_over();
  a_moment_days_away_is_still_exact();
  return check::verdict();
}
