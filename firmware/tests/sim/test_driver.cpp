// The driver alone on the model of its radio: what a whole node would hide by putting it right afterwards.
#include <utility>
#include <vector>

#include "firmware/sim/board.h"
#include "firmware/sim/chip.h"
#include "firmware/sim/events.h"
#include "firmware/sim/radio.h"
#include "tests/cpp/check.h"

extern "C" {
#include "firmware/core/dw1000.h"
#include "firmware/core/ticks.h"
}

namespace {

using air::Femto;
using air::kSecond;

constexpr std::uint64_t kNever = UINT64_MAX;

struct Air : air::Ether {
  void send(air::Chip&, const air::Emission& emission) override { emissions.push_back(emission); }
  std::vector<air::Emission> emissions;
};

struct dw1000_settings settings() {
  struct dw1000_settings settings{};
  settings.channel = 5;
  settings.prf_mhz = 64;
  settings.antenna_delay = 32873;
  return settings;
}

// Runs a program on a board for a second; returns what it sent.
std::vector<air::Emission> sent_by(const air::Board::Program& program) {
  air::Events events;
  Air ether;
  air::Chip chip(events, ether, air::Chip::Nature{});
  air::Board board(events, chip, 1, program);
  board.power_on(0.0);
  const air::Events::Id end = events.at(kSecond + 1, [] {});
  events.run_until(kSecond);
  events.cancel(end);
  CHECK(chip.complaints().empty());
  return ether.emissions;
}

// The stamp that a frame two milliseconds from now is said to have, less the one that it has.
std::int64_t stamp_is_off(air::Board& board, struct dw1000& radio) {
  const std::uint64_t at = ticks_after(dw1000_now(&radio), 2 * TICKS_PER_MS);
  const std::uint8_t frame[10] = {};
  CHECK(dw1000_send_at(&radio, at, frame, sizeof frame, false) == DW1000_OK);
  board.wait_for_interrupt(kNever);
  std::uint8_t buffer[DW1000_MAX_FRAME];
  const struct dw1000_event event = dw1000_service(&radio, buffer);
  CHECK(event.kind == DW1000_SENT);
  return ticks_until(event.stamp, dw1000_stamp_of(&radio, at));
}

void stamps_before_and_after_sleep_have_the_antennas_delay_in_them() {
  const auto emissions = sent_by([](air::Board& board, bool) {
    struct dw1000 radio{};
    const struct dw1000_settings with = settings();
    CHECK(dw1000_start(&radio, board.hal(), &with) == DW1000_OK);
    CHECK_NEAR(static_cast<double>(stamp_is_off(board, radio)), 0.0, 0.0);
    dw1000_sleep(&radio);
    board.hal()->wait(board.hal()->board, 100'000);
    struct dw1000 woken{};
    CHECK(dw1000_wake(&woken, board.hal(), &with) == DW1000_OK);
    CHECK_NEAR(static_cast<double>(stamp_is_off(board, woken)), 0.0, 0.0);
    return kNever;
  });
  CHECK(emissions.size() == 2);
}

void a_frame_whose_moment_has_passed_is_told_so_and_never_sent() {
  const auto emissions = sent_by([](air::Board& board, bool) {
    struct dw1000 radio{};
    const struct dw1000_settings with = settings();
    CHECK(dw1000_start(&radio, board.hal(), &with) == DW1000_OK);
    const std::uint8_t frame[10] = {};
    for (const std::uint64_t late_us : {1, 50, 130, 1000, 1'000'000}) {
      const std::uint64_t at = ticks_after(dw1000_now(&radio), TICKS_MASK + 1 - ticks_of_us(late_us));
      CHECK(dw1000_send_at(&radio, at, frame, sizeof frame, false) == DW1000_TOO_LATE);
    }
    CHECK_NEAR(static_cast<double>(stamp_is_off(board, radio)), 0.0, 0.0);  // and the next one is
    return kNever;
  });
  CHECK(emissions.size() == 1);
}

}  // namespace

int main() {
  stamps_before_and_after_sleep_have_the_antennas_delay_in_them();
  a_frame_whose_moment_has_passed_is_told_so_and_never_sent();
  return check::verdict();
}
