// A board: a processor that runs a program on the radio beside it, by a clock of its own. Whatever the
// program does there takes time, and everything else in the world happens in between.
//
// The program runs on a fiber. What it asks of the hal is done outside of that, so that the fiber's stack
// holds nothing but the program.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "firmware/sim/chip.h"
#include "firmware/sim/crystal.h"
#include "firmware/sim/dice.h"
#include "firmware/sim/events.h"
#include "firmware/sim/fiber.h"

extern "C" {
#include "firmware/core/hal.h"
}

namespace air {

class Board {
 public:
  // Runs from each start on, and returns when by the board's clock it wants to be started again: until then
  // the board is in deep sleep. `slept`: it has just been. It must own nothing while it waits: when power
  // goes it is dropped where it stands.
  using Program = std::function<std::uint64_t(Board&, bool slept)>;

  Board(Events& events, Chip& chip, std::uint64_t seed, Program program);
  ~Board();

  Board(const Board&) = delete;
  Board& operator=(const Board&) = delete;

  // On: it starts at once, its clock at 0. `clock_ppm`: how fast that is.
  void power_on(double clock_ppm);
  void power_off();  // not from within what it asked for
  bool powered() const { return clock_.has_value(); }
  bool asleep() const { return powered() && !fiber_; }

  // A datagram comes from the network; nobody hears it where no program runs.
  void hear(std::vector<std::uint8_t> datagram);

  // The network: false where it takes no datagram.
  std::function<bool(const std::uint8_t* datagram, std::size_t size)> on_send;
  // The program has begun to wait, or is gone.
  std::function<void()> on_wait;

  // Bytes of stack that the program has ever used.
  std::size_t deepest_stack() const;

  // For the program.
  const struct hal* hal() const { return &hal_; }
  // Until the radio's interrupt line is high, a datagram is there or the moment has come.
  void wait_for_interrupt(std::uint64_t deadline_us);
  // Bytes of the next datagram; 0: there is none. What is longer than the room is cut off.
  std::size_t receive(std::uint8_t* datagram, std::size_t room);

 private:
  void start(bool slept);
  void run_at(Femto t);  // whatever comes next: the fiber goes on, or deep sleep ends
  void run();
  void sleep();
  void notify();
  void drop_fiber();
  std::uint64_t now_us() const { return clock_->ticks(events_.now()); }

  // On the fiber: lets so much time pass, then does what is asked for. That must fit into the function object
  // itself: what is dropped on a fiber's stack must own nothing.
  void spend(Femto duration, const std::function<void()>& then);
  void transfer(const std::uint8_t* header, std::size_t header_size, std::uint8_t* data, std::size_t size);

  Events& events_;
  Chip& chip_;
  Dice random_;
  const Program program_;
  struct hal hal_{};

  double clock_ppm_ = 0.0;
  std::optional<Crystal> clock_;  // none: no power
  std::unique_ptr<Fiber> fiber_;  // none: no power, or deep sleep
  std::uint64_t sleep_until_us_ = 0;
  std::size_t deepest_stack_ = 0;
  bool fast_ = false;
  std::deque<std::vector<std::uint8_t>> heard_;

  // What the fiber waits for.
  bool running_ = false;
  enum class Waiting { kNothing, kTime, kInterrupt } waiting_ = Waiting::kNothing;
  Femto duration_ = 0;
  const std::function<void()>* then_ = nullptr;
  std::uint64_t deadline_us_ = 0;
  std::optional<Events::Id> due_;
};

}  // namespace air
