// Nodes that find each other, join, leave, crash and collide, in the simulated air.
#include <map>
#include <set>

#include "firmware/tests/sim/room.h"
#include "tests/cpp/check.h"

using namespace air;

namespace {

constexpr int kLargest = 11;

std::size_t pairs_told(const Room& room, int nodes, double from_s, double to_s) {
  std::size_t pairs = 0;
  for (int a = 1; a <= nodes; ++a) {
    for (int b = a + 1; b <= nodes; ++b) {
      pairs += !room.between(static_cast<std::uint16_t>(a), static_cast<std::uint16_t>(b), from_s, to_s).empty();
    }
  }
  return pairs;
}

int coordinators(Room& room) {
  int found = 0;
  for (const auto& [address, module] : room.world.modules()) {
    found += module->board().powered() && !module->board().asleep() &&
             module->node().ranging.state == RANGING_COORDINATING;
  }
  return found;
}

std::uint16_t coordinator(Room& room) {
  for (const auto& [address, module] : room.world.modules()) {
    if (module->board().powered() && module->node().ranging.state == RANGING_COORDINATING) return address;
  }
  return 0;
}

void two_nodes_find_each_other_and_tell_each_distance_once() {
  Room room({});
  room.add(1, {0.0, 0.0, 1.0});
  room.add(2, {3.0, 0.0, 1.0});
  room.run(2.0);
  const auto told = room.between(1, 2, 1.0, 2.0);
  // 333 rounds a second, two slots to join in ten times of them.
  CHECK(told.size() >= 320 && told.size() <= 334);
  std::set<double> moments;
  for (const Told& one : told) moments.insert(one.clock_s);
  CHECK_NEAR(static_cast<double>(moments.size()), static_cast<double>(told.size()), 0.0);
  CHECK_NEAR(static_cast<double>(room.undecodable), 0.0, 0.0);
}

void everybody_is_taken_up_when_all_start_at_the_same_moment() {
  for (std::uint8_t scheme : {SCHEME_ONE_TO_N, SCHEME_ALL_PAIRS}) {
    Room::Settings settings;
    settings.scheme = scheme;
    Room room(settings);
    for (int i = 1; i <= kLargest; ++i) room.add(static_cast<std::uint16_t>(i), on_circle(i, kLargest));
    room.run(4.0);
    CHECK_NEAR(coordinators(room), 1.0, 0.0);
    // Those between two members are overheard where there is but one who polls.
    CHECK_NEAR(static_cast<double>(pairs_told(room, kLargest, 3.0, 4.0)), kLargest * (kLargest - 1) / 2, 0.0);
  }
}

void one_more_than_there_is_room_for_waits_and_harms_nobody() {
  Room room({});
  for (int i = 1; i <= kLargest + 1; ++i) room.add(static_cast<std::uint16_t>(i), on_circle(i, kLargest + 1));
  room.run(5.0);
  std::set<std::uint16_t> heard;
  for (const Told& one : room.told) {
    if (one.at_s >= 4.0) heard.insert({one.reporter, one.peer});
  }
  CHECK_NEAR(static_cast<double>(heard.size()), kLargest, 0.0);
}

void a_coordinator_that_loses_power_is_replaced_and_the_clock_goes_on() {
  Room room({});
  for (std::uint16_t i = 1; i <= 4; ++i) room.add(i, on_circle(i, 4));
  room.run(2.0);
  const std::uint16_t first = coordinator(room);
  room.world.module(first).board().power_off();
  room.run(3.0);
  const std::uint16_t second = coordinator(room);
  CHECK(second != 0 && second != first);
  std::set<std::uint32_t> epochs;
  double clock_less_time_s[2] = {0.0, 0.0};
  for (const Told& one : room.told) {
    if (one.at_s < 1.0) continue;
    epochs.insert(one.epoch);
    clock_less_time_s[one.at_s > 2.0] = one.clock_s - one.at_s;
  }
  CHECK_NEAR(static_cast<double>(epochs.size()), 1.0, 0.0);
  CHECK_NEAR(clock_less_time_s[1], clock_less_time_s[0], 0.03);  // datagrams wait up to 20 ms
  // Three are left, of whom all range again within a fifth of a second.
  CHECK_NEAR(static_cast<double>(pairs_told(room, 4, 2.2, 2.5)), 3.0, 0.0);
}

void a_member_that_loses_power_is_dropped_and_taken_up_again_when_it_returns() {
  Room room({});
  room.add(1, on_circle(1, 3));
  room.add(2, on_circle(2, 3));
  Module::Stint before, after;
  before.off = seconds(2.0);
  after.on = seconds(4.0);
  room.add(3, resting(on_circle(3, 3)), {before, after});
  room.run(6.0);
  CHECK(room.between(1, 3, 1.0, 2.0).size() > 200);
  CHECK(room.between(1, 3, 2.1, 4.0).empty());
  CHECK(room.between(1, 3, 5.0, 6.0).size() > 200);
  // With two of them left there are three frames in a round, with three four.
  CHECK(room.between(1, 2, 3.0, 4.0).size() > room.between(1, 2, 1.0, 2.0).size() + 50);
  CHECK(spread(room.told).worst < 0.05);
}

void a_restart_too_short_to_be_noticed_gives_no_wrong_range() {
  Room room({});
  room.add(1, on_circle(1, 3));
  room.add(2, on_circle(2, 3));
  std::vector<Module::Stint> stints(30);
  for (std::size_t i = 0; i < stints.size(); ++i) {
    stints[i].on = seconds(0.3 * static_cast<double>(i));
    stints[i].off = stints[i].on + 290 * kMillisecond;
  }
  room.add(3, resting(on_circle(3, 3)), stints);
  room.run(10.0);
  CHECK(room.between(1, 3).size() > 300);
  CHECK(spread(room.told).worst < 0.05);
}

struct wire_order order_for(std::uint16_t module, std::uint64_t sequence, std::uint32_t sleep_s) {
  struct wire_order order {};
  order.session = 0xBEEF1234;
  order.module = module;
  order.sequence = sequence;
  order.sleep_s = sleep_s;
  return order;
}

void tell(Room& room, const struct wire_order& order) {
  std::uint8_t key[WIRE_KEY_SIZE], bytes[WIRE_MAX_SIZE];
  for (std::size_t i = 0; i < sizeof key; ++i) key[i] = static_cast<std::uint8_t>(i);
  const std::size_t size = wire_write_order(&order, key, bytes);
  room.world.module(order.module).board().hear({bytes, bytes + size});
}

void whoever_is_registered_is_told_to_sleep_and_the_others_go_on() {
  for (const bool leads : {true, false}) {
    Room room({});
    for (std::uint16_t i = 1; i <= 3; ++i) room.add(i, on_circle(i, 3));
    room.run(1.5);  // who coordinates has greeted by then: there is something to answer
    const std::uint16_t first = coordinator(room);
    const auto other = static_cast<std::uint16_t>(first == 1 ? 2 : 1);
    const auto leaver = leads ? first : other;
    tell(room, order_for(leaver, 0, 5));
    room.run(1.7);
    CHECK(room.world.module(leaver).board().asleep());
    room.run(2.0);
    for (std::uint16_t i = 1; i <= 3; ++i) {
      for (std::uint16_t j = i + 1; j <= 3; ++j) {
        CHECK(room.between(i, j, 1.75, 2.0).empty() == (i == leaver || j == leaver));
      }
    }
    room.run(9.0);
    CHECK(!room.world.module(leaver).board().asleep());
    CHECK_NEAR(static_cast<double>(pairs_told(room, 3, 8.0, 9.0)), 3.0, 0.0);
    CHECK(spread(room.told).worst < 0.05);
  }
}

void orders_of_another_start_or_played_again_are_not_followed() {
  Room room({});
  for (std::uint16_t i = 1; i <= 2; ++i) room.add(i, on_circle(i, 2));
  room.run(2.0);
  const std::uint16_t first = coordinator(room);
  const auto member = static_cast<std::uint16_t>(first == 1 ? 2 : 1);
  tell(room, order_for(member, std::uint64_t{1} << 32, 100));  // of its next start
  tell(room, order_for(member, 1000000, 100));                 // answers what it has not said yet
  room.run(2.5);
  CHECK(!room.world.module(member).board().asleep());
  tell(room, order_for(member, 3, 1));
  room.run(3.0);
  CHECK(room.world.module(member).board().asleep());
  room.run(5.0);
  tell(room, order_for(member, 3, 100));  // again, to its next start
  room.run(5.5);
  CHECK(!room.world.module(member).board().asleep());
}

void lost_frames_cost_rounds_and_not_the_network() {
  for (std::uint8_t scheme : {SCHEME_ONE_TO_N, SCHEME_ALL_PAIRS}) {
    Room::Settings settings;
    settings.scheme = scheme;
    settings.frame_loss = 0.3;
    Room room(settings);
    for (std::uint16_t i = 1; i <= 4; ++i) room.add(i, on_circle(i, 4));
    room.run(12.0);
    std::set<std::uint32_t> epochs;
    for (const Told& one : room.told) {
      if (one.at_s > 3.0) epochs.insert(one.epoch);
    }
    CHECK_NEAR(static_cast<double>(epochs.size()), 1.0, 0.0);
    CHECK_NEAR(static_cast<double>(pairs_told(room, 4, 11.0, 12.0)), 6.0, 0.0);
    CHECK(spread(room.told).worst < 0.05);
  }
}

void two_networks_that_meet_become_one() {
  Room room({});
  // Out of each other's reach at first, then side by side.
  for (std::uint16_t i = 1; i <= 4; ++i) {
    const double side = i <= 2 ? -1.0 : 1.0;
    Track track;
    track.add(seconds(3.0), {side * 600.0, static_cast<double>(i), 1.0});
    track.add(seconds(4.0), {side * 2.0, static_cast<double>(i), 1.0});
    room.add(i, track, {{}});
  }
  room.run(3.0);
  CHECK_NEAR(coordinators(room), 2.0, 0.0);
  room.run(7.0);
  CHECK_NEAR(coordinators(room), 1.0, 0.0);
  CHECK_NEAR(static_cast<double>(pairs_told(room, 4, 6.0, 7.0)), 6.0, 0.0);
}

void polling_goes_at_the_papers_rate() {
  Room::Settings settings;
  settings.scheme = SCHEME_POLLING;
  Room room(settings);
  for (std::uint16_t i = 1; i <= 3; ++i) room.add(i, on_circle(i, 3));
  room.run(14.0);
  const std::uint16_t first = coordinator(room);
  for (std::uint16_t i = 1; i <= 3; ++i) {
    if (i == first) continue;
    // 1000 / (80 + 21 n) rounds a second for n = 2 partners; members do not range with each other.
    CHECK_NEAR(static_cast<double>(room.between(first, i, 4.0, 14.0).size()), 10.0 * 1000.0 / 122.0, 2.0);
    for (std::uint16_t j = i + 1; j <= 3; ++j) CHECK(j == first || room.between(i, j).empty());
  }
}

}  // namespace

int main() {
  two_nodes_find_each_other_and_tell_each_distance_once();
  everybody_is_taken_up_when_all_start_at_the_same_moment();
  one_more_than_there_is_room_for_waits_and_harms_nobody();
  a_coordinator_that_loses_power_is_replaced_and_the_clock_goes_on();
  a_member_that_loses_power_is_dropped_and_taken_up_again_when_it_returns();
  a_restart_too_short_to_be_noticed_gives_no_wrong_range();
  whoever_is_registered_is_told_to_sleep_and_the_others_go_on();
  orders_of_another_start_or_played_again_are_not_followed();
  lost_frames_cost_rounds_and_not_the_network();
  two_networks_that_meet_become_one();
  polling_goes_at_the_papers_rate();
  return check::verdict();
}
