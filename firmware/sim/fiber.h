// A flow of control with a stack of its own, as a board's processor has. It runs until it yields, and goes on
// where it was.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

namespace air {

class Fiber {
 public:
  static constexpr std::size_t kStack = 65536;  // bytes

  explicit Fiber(std::function<void()> body);

  // Whatever the body still had on its stack is dropped as it is: no destructor runs, as when a board loses
  // power.
  ~Fiber();

  Fiber(const Fiber&) = delete;
  Fiber& operator=(const Fiber&) = delete;

  // Runs the body until it yields or ends. Not from within a fiber. Throws std::runtime_error where the stack
  // was too small.
  void resume();

  // Back to whoever resumed the fiber that calls this.
  static void yield();

  bool ended() const { return ended_; }

  // Bytes of its stack that have ever been used.
  std::size_t deepest() const;

 private:
  struct Contexts;

  static void enter();

  std::function<void()> body_;
  bool ended_ = false;
  std::vector<std::uint8_t> stack_;
  std::unique_ptr<Contexts> contexts_;
};

}  // namespace air
