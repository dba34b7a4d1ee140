// synchronizar-air SCENARIO --port N [--live] [--frames]: the firmware of some modules in a simulated air;
// what they send to the collector of ranges leaves as real UDP datagrams for N on 127.0.0.1. SCENARIO.md
// tells the rest.
#include <poll.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdlib>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>

#include "firmware/sim/world.h"
#include "firmware/targets/host/live.h"
#include "firmware/targets/host/network.h"
#include "firmware/targets/host/scenario.h"

extern "C" {
#include "firmware/core/frame.h"
}

namespace {

using air::Femto;

constexpr int kAbandoned = 1, kBadInput = 2, kBroken = 3;  // exit status

// Nobody reads what is printed here any more, or answers it.
struct Abandoned : std::exception {};

struct Options {
  std::string scenario;
  std::uint16_t port = 0;
  bool frames = false;
  bool live = false;
};

struct UsageError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

Options read_options(int argc, const char* const* argv) {
  Options options;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (word == "--frames") {
      options.frames = true;
    } else if (word == "--live") {
      options.live = true;
    } else if (word == "--port" && i + 1 < argc) {
      char* end = nullptr;
      const long port = std::strtol(argv[++i], &end, 10);
      if (*end != '\0' || port < 1 || port > 65535) throw UsageError("--port is not from 1 to 65535");
      options.port = static_cast<std::uint16_t>(port);
    } else if (options.scenario.empty() && word.rfind('-', 0) != 0) {
      options.scenario = word;
    } else {
      throw UsageError("'" + word + "' is not understood");
    }
  }
  if (options.scenario.empty() || options.port == 0)
    throw UsageError("to be called as: synchronizar-air SCENARIO --port N [--live] [--frames]");
  return options;
}

void tell_frame(std::uint16_t from, const air::Emission& emission) {
  constexpr std::size_t kFcs = 2;
  struct frame frame;
  std::cout << "frame " << air::to_seconds(emission.begin) << ' ' << air::to_seconds(emission.end) << ' '
            << from;
  if (!frame_read(emission.bytes.data(), emission.bytes.size() - kFcs, &frame))
    std::cout << " - other\n";
  else if (frame.kind == FRAME_JOIN)
    std::cout << " - join\n";
  else
    std::cout << ' ' << static_cast<int>(frame.slot) << " word\n";
}

std::ifstream opened(const std::string& path) {
  std::ifstream text(path);
  if (!text) throw UsageError(path + " cannot be read");
  return text;
}

// A line for whatever happens to a module, or comes from it.
void tell_state(air::World& world, std::uint16_t module, std::string_view words) {
  std::cout << "said " << air::to_seconds(world.events().now()) << " node " << module << ' ' << words << '\n';
}

void tell_sent(air::World& world, std::uint16_t from, std::size_t size, std::optional<Femto> measured) {
  std::cout << "sent " << air::to_seconds(world.events().now()) << ' ' << from << ' ' << size << ' ';
  if (measured)
    std::cout << air::to_seconds(*measured);
  else
    std::cout << '-';
  std::cout << '\n';
}

void listen(air::World& world, const Options& options) {
  std::cout << std::fixed << std::setprecision(9);
  world.on_state = [&world](std::uint16_t module, std::string_view words) {
    tell_state(world, module, words);
  };
  if (options.frames) world.medium().on_emission = tell_frame;
}

void run(const Options& options) {
  std::ifstream text = opened(options.scenario);
  const Scenario scenario = read_scenario(text, options.scenario);
  air::World world(scenario.settings);
  for (const air::Module::Spec& node : scenario.nodes) world.add(node);
  for (const Scenario::Late& late : scenario.late)
    world.medium().block(late.a, late.b, late.begin, late.end, late.extra_m);

  listen(world, options);
  std::optional<air::Network> network;
  network.emplace(world, scenario.settings.medium.seed, options.port,
                  [&](std::uint16_t from, std::size_t size, std::optional<Femto> measured) {
                    tell_sent(world, from, size, measured);
                    std::cout << std::flush;
                    std::string answer;
                    if (!std::getline(std::cin, answer)) throw Abandoned();
                    network->carry_down();
                  });
  world.run_until(scenario.length);
  std::cout << "done" << '\n' << std::flush;
}

// Lines of standard input as they come; none is waited for unless that is asked for.
class Lines {
 public:
  // False at the end of all.
  bool read(bool wait) {
    pollfd input{STDIN_FILENO, POLLIN, 0};
    const int ready = ::poll(&input, 1, wait ? -1 : 0);
    if (ready <= 0) return true;
    std::array<char, 65536> bytes;
    const ssize_t size = ::read(STDIN_FILENO, bytes.data(), bytes.size());
    if (size < 0) return errno == EINTR || errno == EAGAIN;
    text_.append(bytes.data(), static_cast<std::size_t>(size));
    return size > 0;
  }

  // The next whole line; nothing where none has come.
  std::optional<std::string> next() {
    const std::size_t end = text_.find('\n', begin_);
    if (end == std::string::npos) {
      text_.erase(0, begin_);
      begin_ = 0;
      // What is longer than any line that means something is not kept until it ends.
      if (text_.size() > kLongestLine) text_.resize(kLongestLine);
      return std::nullopt;
    }
    std::string line = text_.substr(begin_, end - begin_);
    begin_ = end + 1;
    ++number_;
    return line;
  }

  std::uint64_t number() const { return number_; }

 private:
  static constexpr std::size_t kLongestLine = 1000;

  std::string text_;
  std::size_t begin_ = 0;
  std::uint64_t number_ = 0;  // of the latest line
};

void run_live(const Options& options) {
  constexpr Femto kSlice = 10 * air::kMillisecond;
  std::ifstream text = opened(options.scenario);
  const air::World::Settings settings = read_settings(text, options.scenario);
  air::World world(settings);
  listen(world, options);
  air::Network network(world, settings.medium.seed, options.port,
                       [&](std::uint16_t from, std::size_t size, std::optional<Femto> measured) {
                         tell_sent(world, from, size, measured);
                       });
  air::Live live(world);
  Lines lines;
  bool ended = false;
  while (true) {
    const std::optional<Femto> horizon = live.horizon();
    const bool stands = !horizon || *horizon <= world.events().now();
    if (ended && stands) break;
    if (!ended) ended = !lines.read(stands);
    while (const std::optional<std::string> line = lines.next()) {
      try {
        live.take(*line);
      } catch (const std::invalid_argument& fault) {
        std::cerr << "synchronizar-air: line " << lines.number() << ": " << fault.what() << '\n';
      }
    }
    network.carry_down();
    live.run_until(world.events().now() + kSlice);
    std::cout << std::flush;
  }
  std::cout << "done" << '\n' << std::flush;
}

int fail(const std::exception& error, int status) {
  std::cerr << "synchronizar-air: " << error.what() << '\n';
  return status;
}

}  // namespace

int main(int argc, char* const* argv) {
  try {
    const Options options = read_options(argc, argv);
    if (options.live)
      run_live(options);
    else
      run(options);
    return 0;
  } catch (const Abandoned&) {
    return kAbandoned;
  } catch (const UsageError& error) {
    return fail(error, kBadInput);
  } catch (const ScenarioError& error) {
    return fail(error, kBadInput);
  } catch (const std::exception& error) {
    return fail(error, kBroken);
  }
}
