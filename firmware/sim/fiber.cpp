#ifdef __APPLE__
#define _XOPEN_SOURCE 700  // ucontext.h asks for it
#define _DARWIN_C_SOURCE
#pragma clang diagnostic ignored "-Wdeprecated-declarations"
#endif

#undef _FORTIFY_SOURCE  // its longjmp refuses to go to another stack

#include "firmware/sim/fiber.h"

#include <ucontext.h>

#include <array>
#include <csetjmp>
#include <cstring>
#include <stdexcept>
#include <utility>

#ifdef __has_feature
#if __has_feature(address_sanitizer)
#define AIR_ASAN
#endif
#endif
#ifdef __SANITIZE_ADDRESS__
#define AIR_ASAN
#endif

#ifdef AIR_ASAN
#include <sanitizer/common_interface_defs.h>
#endif

namespace air {

namespace {

constexpr std::uint8_t kPaint = 0xA5;

thread_local Fiber* current = nullptr;

// The far end of each stack. Where it loses its paint the stack was too small.
constexpr std::array<std::uint8_t, 256> painted_end() {
  std::array<std::uint8_t, 256> end{};
  for (std::uint8_t& byte : end) byte = kPaint;
  return end;
}
constexpr std::array<std::uint8_t, 256> kEnd = painted_end();

#ifdef AIR_ASAN
// The sanitizer has to be told of each change of stacks. `frames` is where it keeps what it knows of the
// stack that is left; null where that is left for good.
void leave_stack(void** frames, const void* to, std::size_t size) {
  __sanitizer_start_switch_fiber(frames, to, size);
}
void arrive_on_stack(void* frames, const void** from, std::size_t* size) {
  __sanitizer_finish_switch_fiber(frames, from, size);
}
#else
void leave_stack(void**, const void*, std::size_t) {}
void arrive_on_stack(void*, const void**, std::size_t*) {}
#endif

}  // namespace

// The way onto a new stack is a ucontext; from then on stacks change by setjmp and longjmp. swapcontext would
// ask the operating system for the signal mask each time, which takes longer than all else that is simulated.
struct Fiber::Contexts {
  ucontext_t begin;
  bool begun = false;
  jmp_buf fiber, resumer;
  void *fiber_frames = nullptr, *resumer_frames = nullptr;
  const void* resumer_stack = nullptr;
  std::size_t resumer_size = 0;
};

Fiber::Fiber(std::function<void()> body)
    : body_(std::move(body)), stack_(kStack, kPaint), contexts_(std::make_unique<Contexts>()) {
  getcontext(&contexts_->begin);
  contexts_->begin.uc_stack.ss_sp = stack_.data();
  contexts_->begin.uc_stack.ss_size = kStack;
  contexts_->begin.uc_link = nullptr;
  makecontext(&contexts_->begin, &Fiber::enter, 0);
}

Fiber::~Fiber() = default;

void Fiber::enter() {
  Fiber* const self = current;
  Contexts& contexts = *self->contexts_;
  arrive_on_stack(nullptr, &contexts.resumer_stack, &contexts.resumer_size);
  self->body_();
  self->ended_ = true;
  leave_stack(nullptr, contexts.resumer_stack, contexts.resumer_size);
  _longjmp(contexts.resumer, 1);
}

void Fiber::resume() {
  if (current != nullptr) throw std::logic_error("a fiber resumes another");
  if (ended_) throw std::logic_error("a fiber that has ended is resumed");
  current = this;
  leave_stack(&contexts_->resumer_frames, stack_.data(), kStack);
  if (_setjmp(contexts_->resumer) == 0) {
    if (contexts_->begun) _longjmp(contexts_->fiber, 1);
    contexts_->begun = true;
    setcontext(&contexts_->begin);
  }
  arrive_on_stack(contexts_->resumer_frames, nullptr, nullptr);
  current = nullptr;
  if (std::memcmp(stack_.data(), kEnd.data(), kEnd.size()) != 0)
    throw std::runtime_error("a fiber's stack was too small");
}

void Fiber::yield() {
  Contexts& contexts = *current->contexts_;
  leave_stack(&contexts.fiber_frames, contexts.resumer_stack, contexts.resumer_size);
  if (_setjmp(contexts.fiber) == 0) _longjmp(contexts.resumer, 1);
  arrive_on_stack(contexts.fiber_frames, &contexts.resumer_stack, &contexts.resumer_size);
}

// The sanitizer must not look: it holds what lies between the variables of functions that have not returned
// for out of bounds.
#ifdef AIR_ASAN
__attribute__((no_sanitize("address")))
#endif
std::size_t Fiber::deepest() const {
  std::size_t untouched = 0;
  while (untouched < kStack && stack_[untouched] == kPaint) ++untouched;
  return kStack - untouched;
}

}  // namespace air
