// Boards: what a program does takes time, and the rest of the world happens in between.
#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "firmware/sim/board.h"
#include "firmware/sim/chip.h"
#include "firmware/sim/events.h"
#include "firmware/sim/fiber.h"
#include "firmware/sim/radio.h"
#include "tests/cpp/check.h"

extern "C" {
#include "firmware/core/dw1000.h"
#include "firmware/core/ticks.h"
}

namespace {

using air::Femto;
using air::kMicrosecond;
using air::kMillisecond;
using air::kSecond;

constexpr std::uint64_t kNever = UINT64_MAX;

struct SilentEther : air::Ether {
  void send(air::Chip&, const air::Emission& emission) override { emissions.push_back(emission); }
  std::vector<air::Emission> emissions;
};

// A board goes on alone as long as nothing else is due: something has to be, at the end.
void run_until(air::Events& events, Femto t) {
  const air::Events::Id end = events.at(t + 1, [] {});
  events.run_until(t);
  events.cancel(end);
}

// A board with its radio.
struct Bench {
  Bench(air::Events& events, air::Ether& ether, air::Board::Program program, std::uint64_t seed = 1)
      : chip(events, ether, air::Chip::Nature{}), board(events, chip, seed, std::move(program)) {}
  air::Chip chip;
  air::Board board;
};

std::uint32_t read_id(const air::Board& board) {
  const std::uint8_t header = 0x00;  // DEV_ID
  std::uint8_t id[4] = {};
  board.hal()->spi_read(board.hal()->board, &header, 1, id, sizeof id);
  return static_cast<std::uint32_t>(id[0] | id[1] << 8 | id[2] << 16) | static_cast<std::uint32_t>(id[3])
                                                                            << 24;
}

// 15 us, and 40 bits at 3 MHz.
constexpr Femto kReadId = 15 * kMicrosecond + 40 * kSecond / 3'000'000;

void a_fiber_goes_on_where_it_was() {
  std::string said;
  air::Fiber fiber([&said] {
    said += 'a';
    air::Fiber::yield();
    said += 'b';
    air::Fiber::yield();
    said += 'c';
  });
  fiber.resume();
  said += '1';
  fiber.resume();
  said += '2';
  CHECK(!fiber.ended());
  fiber.resume();
  CHECK(fiber.ended());
  CHECK(said == "a1b2c");
}

void a_fiber_that_stands_still_may_be_dropped() {
  for (int i = 0; i < 100; ++i) {
    int steps = 0;
    air::Fiber fiber([&steps] {
      std::uint8_t buffer[1000];
      for (std::size_t n = 0; n < sizeof buffer; ++n) buffer[n] = static_cast<std::uint8_t>(n);
      while (true) {
        steps += buffer[1];
        air::Fiber::yield();
      }
    });
    fiber.resume();
    fiber.resume();
    CHECK_NEAR(steps, 2, 0);
  }
}

// Not inlined, and not turned into a loop.
__attribute__((noinline)) int dig(int depth) {
  volatile std::uint8_t hole[1024];
  hole[0] = static_cast<std::uint8_t>(depth);
  return depth == 0 ? hole[0] : dig(depth - 1) + hole[0];
}

void a_fiber_tells_how_deep_its_stack_was() {
  const auto depth_of = [](int depth) {
    air::Fiber fiber([depth] { (void)dig(depth); });
    fiber.resume();
    return static_cast<double>(fiber.deepest());
  };
  // Each level has its kilobyte and what the compiler, or a sanitizer, puts around it.
  CHECK_NEAR(depth_of(20) - depth_of(0), 20 * 1280.0, 20 * 256.0);
}

void reading_takes_the_time_of_its_bits() {
  air::Events events;
  SilentEther ether;
  std::vector<std::uint64_t> us;
  std::uint32_t id = 0;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    us.push_back(board.hal()->now_us(board.hal()->board));
    id = read_id(board);
    us.push_back(board.hal()->now_us(board.hal()->board));
    for (int i = 0; i < 99; ++i) (void)read_id(board);
    us.push_back(board.hal()->now_us(board.hal()->board));
    return kNever;
  });
  events.at(kSecond, [&] { bench.board.power_on(0.0); });
  run_until(events, 2 * kSecond);
  CHECK(id == 0xDECA0130);
  CHECK(us == (std::vector<std::uint64_t>{0, 28, 2833}));  // 28.333 us each
}

void the_slow_bus_takes_longer_than_the_fast_one() {
  air::Events events;
  SilentEther ether;
  std::vector<std::uint64_t> us;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    const struct hal* hal = board.hal();
    const std::uint8_t header = 0x09 | 0x80;  // TX_BUFFER, written
    std::uint8_t data[99] = {};
    hal->spi_write(hal->board, &header, 1, data, sizeof data);
    us.push_back(hal->now_us(hal->board));
    hal->spi_fast(hal->board, true);
    hal->spi_write(hal->board, &header, 1, data, sizeof data);
    us.push_back(hal->now_us(hal->board));
    return kNever;
  });
  bench.board.power_on(0.0);
  run_until(events, kSecond);
  CHECK(us == (std::vector<std::uint64_t>{281, 281 + 55}));  // 15 us and 800 bits: 266.7 us, 40 us
}

void two_boards_and_the_rest_of_the_world_happen_in_the_order_of_time() {
  air::Events events;
  SilentEther ether;
  struct Happened {
    Femto t;
    char who;
  };
  std::vector<Happened> log;
  const auto reader = [&](char who) {
    return [&log, &events, who](air::Board& board, bool) {
      for (int i = 0; i < 50; ++i) {
        (void)read_id(board);
        log.push_back({events.now(), who});
      }
      return kNever;
    };
  };
  Bench a(events, ether, reader('a')), b(events, ether, reader('b'));
  events.at(0, [&] { a.board.power_on(0.0); });
  events.at(7 * kMicrosecond, [&] { b.board.power_on(0.0); });
  for (int i = 1; i <= 130; ++i)
    events.at(i * 11 * kMicrosecond, [&] { log.push_back({events.now(), 'r'}); });
  run_until(events, kSecond);

  std::vector<Happened> expected;
  for (int i = 1; i <= 50; ++i) expected.push_back({i * kReadId, 'a'});
  for (int i = 1; i <= 50; ++i) expected.push_back({7 * kMicrosecond + i * kReadId, 'b'});
  for (int i = 1; i <= 130; ++i) expected.push_back({i * 11 * kMicrosecond, 'r'});
  std::sort(expected.begin(), expected.end(), [](const Happened& x, const Happened& y) { return x.t < y.t; });
  const auto same = [](const Happened& x, const Happened& y) { return x.t == y.t && x.who == y.who; };
  CHECK(std::equal(log.begin(), log.end(), expected.begin(), expected.end(), same));
}

void what_is_due_at_the_same_moment_and_was_asked_for_before_happens_before() {
  air::Events events;
  SilentEther ether;
  std::string said;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    (void)read_id(board);
    said += 'b';
    return kNever;
  });
  bench.board.power_on(0.0);
  events.at(kReadId, [&] { said += 'e'; });
  run_until(events, kSecond);
  CHECK(said == "eb");
}

void a_board_that_is_alone_does_not_run_ahead_of_what_is_simulated() {
  air::Events events;
  SilentEther ether;
  Femto latest = 0;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    while (true) {
      board.hal()->wait(board.hal()->board, 10);
      latest = events.now();
    }
    return kNever;
  });
  bench.board.power_on(0.0);
  for (Femto t = kMillisecond; t <= 10 * kMillisecond; t += kMillisecond) {
    run_until(events, t);
    CHECK(latest == t);
  }
}

void a_board_wakes_at_its_deadline_by_its_own_clock() {
  air::Events events;
  SilentEther ether;
  Femto woke = 0;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    board.wait_for_interrupt(1'000'000);
    woke = events.now();
    CHECK(board.hal()->now_us(board.hal()->board) == 1'000'015);
    return kNever;
  });
  events.at(5 * kSecond, [&] { bench.board.power_on(100.0); });
  run_until(events, 7 * kSecond);
  // Too fast by 100 ppm: a second is over after 999,900.01 us, and 15 us later the program knows.
  CHECK_NEAR(air::to_seconds(woke - 5 * kSecond) * 1e6, 999'900.01 + 15.0, 0.01);
}

void a_board_whose_deadline_is_over_goes_on_at_once_but_time_passes() {
  air::Events events;
  SilentEther ether;
  int rounds = 0;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    for (rounds = 0; rounds < 1000; ++rounds) board.wait_for_interrupt(0);
    return kNever;
  });
  bench.board.power_on(0.0);
  run_until(events, kMillisecond);
  CHECK_NEAR(rounds, 500, 1);
}

void an_interrupt_ends_the_wait() {
  air::Events events;
  SilentEther ether;
  Femto woke = 0;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    struct dw1000 radio;
    struct dw1000_settings settings{};
    settings.channel = 5;
    settings.prf_mhz = 64;
    settings.antenna_delay = 32873;
    CHECK(dw1000_start(&radio, board.hal(), &settings) == DW1000_OK);
    const std::uint8_t frame[20] = {};
    const std::uint64_t soon = ticks_after(dw1000_now(&radio), ticks_of_us(1000));
    CHECK(dw1000_send_at(&radio, soon, frame, sizeof frame, false) == DW1000_OK);
    board.wait_for_interrupt(kNever);
    woke = events.now();
    CHECK(board.hal()->interrupted(board.hal()->board));
    return kNever;
  });
  bench.board.power_on(0.0);
  run_until(events, kSecond);
  CHECK(ether.emissions.size() == 1);
  const double late_us = air::to_seconds(woke - ether.emissions.at(0).end) * 1e6;
  CHECK_NEAR(late_us, 15.0, 1.0);
}

void a_datagram_ends_the_wait_and_is_received_whole() {
  air::Events events;
  SilentEther ether;
  std::vector<std::size_t> sizes;
  std::uint8_t last = 0;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    std::uint8_t datagram[100];
    board.wait_for_interrupt(kNever);
    for (int i = 0; i < 3; ++i) sizes.push_back(board.receive(datagram, sizeof datagram));
    last = datagram[99];
    return kNever;
  });
  bench.board.hear({9, 9, 9});  // has no power
  bench.board.power_on(0.0);
  events.at(kSecond, [&] {
    bench.board.hear({1, 2, 3});
    bench.board.hear(std::vector<std::uint8_t>(300, 7));
  });
  run_until(events, 2 * kSecond);
  CHECK(sizes == (std::vector<std::size_t>{3, 100, 0}));
  CHECK_NEAR(last, 7, 0);
}

void what_is_sent_comes_to_the_network() {
  air::Events events;
  SilentEther ether;
  std::vector<bool> taken;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    const std::uint8_t datagram[] = {1, 2, 3, 4};
    for (int i = 0; i < 2; ++i)
      taken.push_back(board.hal()->send(board.hal()->board, datagram, sizeof datagram));
    return kNever;
  });
  std::size_t sizes = 0;
  bench.board.on_send = [&](const std::uint8_t* datagram, std::size_t size) {
    CHECK(datagram[3] == 4);
    sizes += size;
    return sizes == 4;
  };
  bench.board.power_on(0.0);
  run_until(events, kSecond);
  CHECK_NEAR(static_cast<double>(sizes), 8, 0);
  CHECK(taken == (std::vector<bool>{true, false}));
}

void without_power_everything_ends_and_with_it_everything_begins_anew() {
  air::Events events;
  SilentEther ether;
  int starts = 0, steps = 0;
  std::vector<std::uint64_t> began;
  std::vector<std::uint32_t> random;
  Bench bench(events, ether, [&](air::Board& board, bool slept) {
    CHECK(!slept);
    ++starts;
    began.push_back(board.hal()->now_us(board.hal()->board));
    random.push_back(board.hal()->random(board.hal()->board));
    while (true) {
      (void)read_id(board);
      board.wait_for_interrupt(board.hal()->now_us(board.hal()->board) + 1000);
      ++steps;
    }
    return kNever;
  });
  // In the middle of a wait, of a transaction and of a notification.
  const std::vector<Femto> lengths = {3500 * kMicrosecond, 10 * kMicrosecond, 1040 * kMicrosecond};
  for (std::size_t i = 0; i < lengths.size(); ++i) {
    const Femto on = static_cast<Femto>(10 * i + 1) * kMillisecond;
    events.at(on, [&] { bench.board.power_on(0.0); });
    events.at(on + lengths[i], [&] { bench.board.power_off(); });
  }
  run_until(events, 5 * kMillisecond);
  CHECK(!bench.board.powered());
  CHECK_NEAR(steps, 3, 0);
  run_until(events, 10 * kMillisecond);
  CHECK_NEAR(steps, 3, 0);
  run_until(events, kSecond);
  CHECK_NEAR(starts, 3, 0);
  CHECK_NEAR(steps, 3, 0);
  CHECK(began == (std::vector<std::uint64_t>{0, 0, 0}));
  CHECK(random.at(0) != random.at(1) && random.at(1) != random.at(2));
  CHECK(events.next(2 * kSecond) == 2 * kSecond);  // nothing is left behind
}

void a_datagram_that_nobody_received_is_forgotten_without_power() {
  air::Events events;
  SilentEther ether;
  std::vector<std::size_t> sizes;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    board.hal()->wait(board.hal()->board, 1000);
    std::uint8_t datagram[10];
    sizes.push_back(board.receive(datagram, sizeof datagram));
    return kNever;
  });
  bench.board.power_on(0.0);
  events.at(500 * kMicrosecond, [&] {
    bench.board.hear({1, 2, 3});
    bench.board.power_off();
    bench.board.power_on(0.0);
  });
  run_until(events, kSecond);
  CHECK(sizes == (std::vector<std::size_t>{0}));
}

void a_board_in_deep_sleep_wakes_by_its_own_clock_and_knows_that_it_slept() {
  air::Events events;
  SilentEther ether;
  struct Start {
    Femto t;
    bool slept;
  };
  std::vector<Start> starts;
  std::vector<bool> asleep;
  Bench bench(events, ether, [&](air::Board& board, bool slept) {
    starts.push_back({events.now(), slept});
    board.hal()->wait(board.hal()->board, 100);
    return starts.size() < 3 ? std::uint64_t{60'000'000} : kNever;
  });
  bench.board.on_wait = [&] { asleep.push_back(bench.board.asleep()); };
  bench.board.power_on(-50.0);
  run_until(events, 1000 * kSecond);
  CHECK(starts.size() == 3);
  for (std::size_t i = 0; i < starts.size(); ++i) {
    CHECK_NEAR(air::to_seconds(starts[i].t), static_cast<double>(i) * 60.0 / (1.0 - 50e-6), 1e-6);
    CHECK(starts[i].slept == (i > 0));
  }
  CHECK(asleep == (std::vector<bool>{true, true, true}));
  CHECK(bench.board.powered() && bench.board.asleep());
  bench.board.power_off();
  CHECK(!bench.board.powered() && !bench.board.asleep());
}

void the_same_seed_draws_the_same_and_another_seed_does_not() {
  const auto drawn = [](std::uint64_t seed) {
    air::Events events;
    SilentEther ether;
    std::uint32_t random = 0;
    Bench bench(
        events, ether,
        [&](air::Board& board, bool) {
          random = board.hal()->random(board.hal()->board);
          return kNever;
        },
        seed);
    bench.board.power_on(0.0);
    run_until(events, kMillisecond);
    return random;
  };
  CHECK(drawn(1) == drawn(1));
  CHECK(drawn(1) != drawn(2));
}

void power_cannot_fail_in_the_middle_of_what_a_board_asked_for() {
  air::Events events;
  SilentEther ether;
  Bench bench(events, ether, [&](air::Board& board, bool) {
    const std::uint8_t datagram = 0;
    (void)board.hal()->send(board.hal()->board, &datagram, 1);
    return kNever;
  });
  bool refused = false;
  bench.board.on_send = [&](const std::uint8_t*, std::size_t) {
    try {
      bench.board.power_off();
    } catch (const std::logic_error&) {
      refused = true;
    }
    return true;
  };
  bench.board.power_on(0.0);
  run_until(events, kMillisecond);
  CHECK(refused);
}

}  // namespace

int main() {
  a_fiber_goes_on_where_it_was();
  a_fiber_that_stands_still_may_be_dropped();
  a_fiber_tells_how_deep_its_stack_was();
  reading_takes_the_time_of_its_bits();
  the_slow_bus_takes_longer_than_the_fast_one();
  two_boards_and_the_rest_of_the_world_happen_in_the_order_of_time();
  what_is_due_at_the_same_moment_and_was_asked_for_before_happens_before();
  a_board_that_is_alone_does_not_run_ahead_of_what_is_simulated();
  a_board_wakes_at_its_deadline_by_its_own_clock();
  a_board_whose_deadline_is_over_goes_on_at_once_but_time_passes();
  an_interrupt_ends_the_wait();
  a_datagram_ends_the_wait_and_is_received_whole();
  what_is_sent_comes_to_the_network();
  without_power_everything_ends_and_with_it_everything_begins_anew();
  a_datagram_that_nobody_received_is_forgotten_without_power();
  a_board_in_deep_sleep_wakes_by_its_own_clock_and_knows_that_it_slept();
  the_same_seed_draws_the_same_and_another_seed_does_not();
  power_cannot_fail_in_the_middle_of_what_a_board_asked_for();
  return check::verdict();
}
