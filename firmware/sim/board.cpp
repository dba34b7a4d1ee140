#include "firmware/sim/board.h"

#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <utility>

namespace air {

namespace {

// A polled transaction takes an ESP32 10 us besides its bits (Espressif's guide to the SPI master driver,
// transaction duration). 5 more are for what the program computes in between: assumed.
constexpr Femto kTransaction = 15 * kMicrosecond;
constexpr std::int64_t kSlowHz = 3'000'000, kFastHz = 20'000'000;  // all that the DW1000 takes (DS 5.8)

// Assumed, for an ESP32 at 240 MHz: from the line, the timer or the network to the task that waits for it; to
// find that there is nothing to wait for; to pulse RSTn; to hand a datagram to the network's task.
constexpr Femto kNotification = 15 * kMicrosecond;
constexpr Femto kCheck = 2 * kMicrosecond;
constexpr Femto kReset = 10 * kMicrosecond;
constexpr Femto kSend = 100 * kMicrosecond;

constexpr std::uint64_t kNeverUs = UINT64_C(1'000'000'000'000'000);  // thirty years

Board& board_of(void* board) { return *static_cast<Board*>(board); }

}  // namespace

Board::Board(Events& events, Chip& chip, std::uint64_t seed, Program program)
    : events_(events), chip_(chip), random_{seed}, program_(std::move(program)) {
  hal_.board = this;
  hal_.spi_write = [](void* board, const std::uint8_t* header, std::size_t header_size,
                      const std::uint8_t* data, std::size_t size) {
    // The radio leaves the data of a write as they are.
    board_of(board).transfer(header, header_size, const_cast<std::uint8_t*>(data), size);
  };
  hal_.spi_read = [](void* board, const std::uint8_t* header, std::size_t header_size, std::uint8_t* data,
                     std::size_t size) { board_of(board).transfer(header, header_size, data, size); };
  hal_.spi_fast = [](void* board, bool fast) { board_of(board).fast_ = fast; };
  hal_.reset = [](void* board) {
    Board& self = board_of(board);
    self.spend(kReset, [&self] { self.chip_.reset(); });
  };
  hal_.select_for = [](void* board, std::uint32_t us) {
    Board& self = board_of(board);
    self.spend(us * kMicrosecond, [&self, us] { self.chip_.select_for(us * kMicrosecond); });
  };
  hal_.wait = [](void* board, std::uint32_t us) { board_of(board).spend(us * kMicrosecond, [] {}); };
  hal_.interrupted = [](void* board) { return board_of(board).chip_.interrupt(); };
  hal_.now_us = [](void* board) { return board_of(board).now_us(); };
  hal_.random = [](void* board) { return static_cast<std::uint32_t>(board_of(board).random_.next()); };
  hal_.send = [](void* board, const std::uint8_t* datagram, std::size_t size) {
    Board& self = board_of(board);
    struct {
      const std::uint8_t* datagram;
      std::size_t size;
      bool taken;
    } call{datagram, size, false};
    self.spend(kSend,
               [&self, &call] { call.taken = self.on_send && self.on_send(call.datagram, call.size); });
    return call.taken;
  };
  chip_.on_interrupt = [this] { notify(); };
}

Board::~Board() { chip_.on_interrupt = nullptr; }

void Board::power_on(double clock_ppm) {
  if (powered()) throw std::logic_error("a board that has power is given power");
  clock_ppm_ = clock_ppm;
  chip_.power(true);
  start(false);
}

void Board::power_off() {
  if (running_) throw std::logic_error("a board loses power in the middle of what it does");
  if (due_) events_.cancel(*due_);
  due_.reset();
  waiting_ = Waiting::kNothing;
  drop_fiber();
  clock_.reset();
  heard_.clear();
  chip_.power(false);
  if (on_wait) on_wait();
}

void Board::hear(std::vector<std::uint8_t> datagram) {
  if (!fiber_) return;
  heard_.push_back(std::move(datagram));
  notify();
}

std::size_t Board::deepest_stack() const { return std::max(deepest_stack_, fiber_ ? fiber_->deepest() : 0); }

void Board::wait_for_interrupt(std::uint64_t deadline_us) {
  waiting_ = Waiting::kInterrupt;
  deadline_us_ = deadline_us;
  Fiber::yield();
}

std::size_t Board::receive(std::uint8_t* datagram, std::size_t room) {
  if (heard_.empty()) return 0;
  const std::size_t size = std::min(room, heard_.front().size());
  std::memcpy(datagram, heard_.front().data(), size);
  heard_.pop_front();
  return size;
}

void Board::start(bool slept) {
  clock_.emplace(1e6, clock_ppm_, events_.now());
  fast_ = false;
  fiber_ = std::make_unique<Fiber>([this, slept] { sleep_until_us_ = program_(*this, slept); });
  run_at(events_.now());
}

void Board::run_at(Femto t) {
  due_ = events_.at(t, [this] {
    due_.reset();
    if (fiber_)
      run();
    else
      start(true);
  });
}

void Board::run() {
  running_ = true;
  while (true) {
    if (then_ != nullptr) (*std::exchange(then_, nullptr))();
    waiting_ = Waiting::kNothing;
    fiber_->resume();
    if (fiber_->ended()) {
      running_ = false;
      return sleep();
    }
    if (waiting_ == Waiting::kInterrupt) {
      if (on_wait) on_wait();
      const bool at_once = chip_.interrupt() || !heard_.empty() || deadline_us_ <= now_us();
      if (!at_once) {
        running_ = false;
        if (deadline_us_ < kNeverUs) run_at(clock_->when(deadline_us_) + kNotification);
        return;
      }
      duration_ = kCheck;
    }
    waiting_ = Waiting::kTime;
    const Femto t = events_.now() + duration_;
    if (events_.next(t + 1) <= t) {
      running_ = false;
      return run_at(t);
    }
    events_.advance(t);
  }
}

void Board::sleep() {
  drop_fiber();
  heard_.clear();
  if (on_wait) on_wait();
  if (sleep_until_us_ < kNeverUs) run_at(std::max(clock_->when(sleep_until_us_), events_.now()));
}

void Board::notify() {
  if (waiting_ != Waiting::kInterrupt) return;
  const Femto t = events_.now() + kNotification;
  if (due_ && due_->first <= t) return;
  if (due_) events_.cancel(*due_);
  run_at(t);
}

void Board::drop_fiber() {
  deepest_stack_ = deepest_stack();
  fiber_.reset();
  then_ = nullptr;
}

void Board::spend(Femto duration, const std::function<void()>& then) {
  waiting_ = Waiting::kTime;
  duration_ = duration;
  then_ = &then;
  Fiber::yield();
}

void Board::transfer(const std::uint8_t* header, std::size_t header_size, std::uint8_t* data,
                     std::size_t size) {
  const std::int64_t hz = fast_ ? kFastHz : kSlowHz;
  struct {
    const std::uint8_t* header;
    std::size_t header_size;
    std::uint8_t* data;
    std::size_t size;
    double hz;
  } call{header, header_size, data, size, static_cast<double>(hz)};
  const auto bits = static_cast<std::int64_t>(8 * (header_size + size));
  spend(kTransaction + kSecond * bits / hz,
        [this, &call] { chip_.spi(call.header, call.header_size, call.data, call.size, call.hz); });
}

}  // namespace air
