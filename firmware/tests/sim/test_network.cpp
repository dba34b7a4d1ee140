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
      pairs +=
          !room.between(static_cast<std::uint16_t>(a), static_cast<std::uint16_t>(b), from_s, to_s).empty();
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
    CHECK_NEAR(static_cast<double>(pairs_told(room, kLargest, 1.0, 1.5)), kLargest * (kLargest - 1) / 2, 0.0);
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

// How far the clock that ranges are told by is ahead of the world's, on average, in one of its epochs.
std::map<std::uint32_t, double> clocks_ahead_s(const Room& room, double from_s, double to_s) {
  std::map<std::uint32_t, std::pair<double, double>> sums;
  for (const Told& one : room.told) {
    if (one.at_s < from_s || one.at_s >= to_s) continue;
    sums[one.epoch].first += one.clock_s - one.at_s;
    sums[one.epoch].second += 1.0;
  }
  std::map<std::uint32_t, double> ahead_s;
  for (const auto& [epoch, sum] : sums) ahead_s[epoch] = sum.first / sum.second;
  return ahead_s;
}

void a_coordinator_that_loses_power_is_replaced_and_time_goes_on_by_another_name() {
  Room room({});
  for (std::uint16_t i = 1; i <= 4; ++i) room.add(i, on_circle(i, 4));
  room.run(2.0);
  const std::uint16_t first = coordinator(room);
  room.world.module(first).board().power_off();
  room.run(3.0);
  const std::uint16_t second = coordinator(room);
  CHECK(second != 0 && second != first);
  const auto before = clocks_ahead_s(room, 1.0, 2.0), after = clocks_ahead_s(room, 2.2, 3.0);
  CHECK(before.size() == 1 && after.size() == 1);
  CHECK(before.begin()->first != after.begin()->first);
  CHECK_NEAR(after.begin()->second, before.begin()->second, 1e-3);
  // Three are left, of whom all range again within a fifth of a second.
  CHECK_NEAR(static_cast<double>(pairs_told(room, 4, 2.2, 2.5)), 3.0, 0.0);
}

void a_network_that_falls_in_two_has_two_clocks() {
  Room room({});
  for (std::uint16_t i = 1; i <= 4; ++i) {
    Track track;
    track.add(seconds(2.0), {0.0, static_cast<double>(i), 1.0});
    track.add(seconds(2.1), {i <= 2 ? -600.0 : 600.0, static_cast<double>(i), 1.0});
    track.add(seconds(6.0), {i <= 2 ? -600.0 : 600.0, static_cast<double>(i), 1.0});
    track.add(seconds(6.1), {0.0, static_cast<double>(i), 1.0});
    room.add(i, track, {{}});
  }
  room.run(10.0);
  CHECK_NEAR(static_cast<double>(clocks_ahead_s(room, 1.0, 2.0).size()), 1.0, 0.0);
  CHECK_NEAR(static_cast<double>(clocks_ahead_s(room, 3.0, 6.0).size()), 2.0, 0.0);
  CHECK_NEAR(static_cast<double>(clocks_ahead_s(room, 9.0, 10.0).size()), 1.0, 0.0);
  CHECK_NEAR(coordinators(room), 1.0, 0.0);
}

// A module's address, and when it said that it leaves.
std::map<std::uint16_t, double> last_words(Room& room, double until_s) {
  std::map<std::uint16_t, double> said;
  room.world.medium().on_emission = [&](std::uint16_t from, const Emission& emission) {
    struct frame frame{};
    if (frame_read(emission.bytes.data(), emission.bytes.size() - 2, &frame) && frame.leaving)
      said[from] = room.now_s();
  };
  room.run(until_s);
  room.world.medium().on_emission = nullptr;
  return said;
}

void whoever_ends_ranging_has_said_so_on_the_air() {
  std::size_t left = 0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Room::Settings settings;
    settings.range_s = 2;
    settings.sleep_s = 100;
    settings.seed = seed;
    Room room(settings);
    for (std::uint16_t i = 1; i <= 4; ++i) {
      Module::Stint stint;
      stint.on = seconds(0.05 * i * static_cast<double>(seed));
      room.add(i, on_circle(i, 4), stint);
    }
    left += last_words(room, 6.0).size();
  }
  CHECK_NEAR(static_cast<double>(left), 40.0, 0.0);
}

void a_radio_that_fails_is_started_anew_and_its_clock_has_another_name() {
  Room room({});
  room.add(1, on_circle(1, 2));
  room.add(2, on_circle(2, 2));
  room.run(2.0);
  std::set<std::uint32_t> epochs;
  for (int failure = 0; failure < 4; ++failure) {
    for (const auto& [epoch, ahead] : clocks_ahead_s(room, room.now_s() - 1.0, room.now_s()))
      epochs.insert(epoch);
    for (std::uint16_t i = 1; i <= 2; ++i) room.world.module(i).chip().power(false);
    room.run(room.now_s() + 7.0);
    for (std::uint16_t i = 1; i <= 2; ++i) {
      CHECK(room.world.module(i).node().state == NODE_SILENT);
      room.world.module(i).chip().power(true);
    }
    room.run(room.now_s() + 3.0);
    CHECK(!room.between(1, 2, room.now_s() - 0.5).empty());
  }
  CHECK_NEAR(static_cast<double>(epochs.size()), 4.0, 0.0);
  CHECK_NEAR(room.world.module(1).starts(), 1.0, 0.0);
}

void a_module_whose_radio_does_not_answer_sleeps_all_the_same() {
  Room::Settings settings;
  settings.range_s = 10;
  settings.sleep_s = 60;
  Room room(settings);
  room.add(1, on_circle(1, 2));
  room.run(0.5);
  room.world.module(1).chip().power(false);
  room.run(9.0);
  CHECK(room.world.module(1).node().state == NODE_SILENT);
  room.run(12.0);
  CHECK(room.world.module(1).board().asleep());
}

void who_hears_members_but_not_their_coordinator_waits_and_joins_once_it_is_near() {
  Room room({});
  room.add(1, {0.0, 0.0, 1.0});
  room.add(2, {27.0, 0.0, 1.0});
  Track track;
  track.add(seconds(5.0), {54.0, 0.0, 1.0});
  track.add(seconds(6.0), {13.0, 5.0, 1.0});
  Module::Stint later;
  later.on = seconds(1.0);
  room.add(3, track, {later});
  room.run(5.0);
  CHECK(room.between(1, 3).empty());
  CHECK(room.between(1, 2, 4.0, 5.0).size() > 200);
  room.run(8.0);
  CHECK(room.between(1, 3, 7.0, 8.0).size() > 100);
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
  struct wire_order order{};
  order.session = 0xBEEF1234;
  order.module = module;
  order.sequence = sequence;
  order.sleep_s = sleep_s;
  return order;
}

void tell(Room& room, const struct wire_order& order, const Module::Key& key) {
  std::uint8_t bytes[WIRE_MAX_SIZE];
  const std::size_t size = wire_write_order(&order, key.data(), bytes);
  room.world.module(order.module).board().hear({bytes, bytes + size});
}

void tell(Room& room, const struct wire_order& order) { tell(room, order, key_of(order.module)); }

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
    // The same clock goes on, since whose it was said that it leaves.
    CHECK_NEAR(static_cast<double>(clocks_ahead_s(room, 1.0, 2.0).size()), 1.0, 0.0);
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
  tell(room, order_for(member, 3, 100), key_of(first));        // by whoever has another module's key
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
    CHECK_NEAR(static_cast<double>(clocks_ahead_s(room, 3.0, 12.0).size()), 1.0, 0.0);
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
  a_coordinator_that_loses_power_is_replaced_and_time_goes_on_by_another_name();
  a_network_that_falls_in_two_has_two_clocks();
  whoever_ends_ranging_has_said_so_on_the_air();
  a_radio_that_fails_is_started_anew_and_its_clock_has_another_name();
  a_module_whose_radio_does_not_answer_sleeps_all_the_same();
  who_hears_members_but_not_their_coordinator_waits_and_joins_once_it_is_near();
  a_member_that_loses_power_is_dropped_and_taken_up_again_when_it_returns();
  a_restart_too_short_to_be_noticed_gives_no_wrong_range();
  whoever_is_registered_is_told_to_sleep_and_the_others_go_on();
  orders_of_another_start_or_played_again_are_not_followed();
  lost_frames_cost_rounds_and_not_the_network();
  two_networks_that_meet_become_one();
  polling_goes_at_the_papers_rate();
  return check::verdict();
}
