// synchronizar-air SCENARIO --port N [--frames]: the firmware of some modules in a simulated air; what they
// send to the collector of ranges leaves as real UDP datagrams for N on 127.0.0.1. SCENARIO.md tells the
// rest.
#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <system_error>
#include <vector>

#include "firmware/sim/dice.h"
#include "firmware/sim/world.h"
#include "firmware/targets/host/scenario.h"

extern "C" {
#include "firmware/core/frame.h"
#include "firmware/core/wire.h"
}

namespace {

using air::Femto;

constexpr int kAbandoned = 1, kBadInput = 2, kBroken = 3;  // exit status

// From a module to the collector over Wi-Fi and back: at least 1.5 ms, and 1.5 ms more on average. So an
// access point that is not busy behaves while the stations' power save is off (assumed). One station's
// datagrams do not overtake each other.
constexpr double kWifiLeastS = 1.5e-3, kWifiMoreS = 1.5e-3;
constexpr std::uint64_t kWifiDice = 0xF1;

// Nobody reads what is printed here any more, or answers it.
struct Abandoned : std::exception {};

struct Options {
  std::string scenario;
  std::uint16_t port = 0;
  bool frames = false;
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
    throw UsageError("to be called as: synchronizar-air SCENARIO --port N [--frames]");
  return options;
}

// A module's way to the collector, with a port of its own: what the collector sends back there is for that
// module.
class Socket {
 public:
  explicit Socket(std::uint16_t collector_port) : handle_(::socket(AF_INET, SOCK_DGRAM, 0)) {
    sockaddr_in collector{};
    collector.sin_family = AF_INET;
    collector.sin_port = htons(collector_port);
    collector.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (handle_ < 0 ||
        ::connect(handle_, reinterpret_cast<const sockaddr*>(&collector), sizeof collector) != 0)
      throw std::system_error(errno, std::generic_category(), "no socket");
  }
  ~Socket() { ::close(handle_); }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;

  // Nobody may be listening; then the datagram is lost, as it would be on a network.
  void send(const std::vector<std::uint8_t>& datagram) const {
    (void)::send(handle_, datagram.data(), datagram.size(), 0);
  }

  // What has come in by now; empty: nothing.
  std::vector<std::uint8_t> receive() const {
    std::vector<std::uint8_t> datagram(2048);
    const ssize_t size = ::recv(handle_, datagram.data(), datagram.size(), MSG_DONTWAIT);
    datagram.resize(size > 0 ? static_cast<std::size_t>(size) : 0);
    return datagram;
  }

 private:
  int handle_;
};

// The network between the modules of a world and the collector.
class Network {
 public:
  Network(air::World& world, const air::World::Settings& settings, std::uint16_t port) : world_(world) {
    for (const auto& [address, module] : world.modules())
      stations_.try_emplace(address, air::Dice{settings.medium.seed, kWifiDice, address}, port);
    world.on_datagram = [this](std::uint16_t from, const std::uint8_t* datagram, std::size_t size) {
      carry_up(from, {datagram, datagram + size});
      return true;
    };
  }

 private:
  struct Station {
    Station(const air::Dice& some_dice, std::uint16_t port) : dice(some_dice), socket(port) {}
    air::Dice dice;
    Socket socket;
    Femto up = 0, down = 0;  // when the latest datagram comes there
  };

  Femto arrival(Station& station, Femto latest) {
    const Femto latency = air::seconds(kWifiLeastS + kWifiMoreS * station.dice.exponential());
    return std::max(world_.events().now() + latency, latest);
  }

  void carry_up(std::uint16_t from, std::vector<std::uint8_t> datagram) {
    Station& station = stations_.at(from);
    station.up = arrival(station, station.up);
    const std::optional<Femto> measured = newest_measured(from, datagram);
    world_.events().at(station.up,
                       [this, from, measured, sent = std::move(datagram)] { deliver(from, sent, measured); });
  }

  // When the newest range that a module tells was measured, as the module has its time now.
  std::optional<Femto> newest_measured(std::uint16_t from, const std::vector<std::uint8_t>& datagram) const {
    struct wire_ranges told;
    const air::Module::Key& key = world_.module(from).key();
    if (!wire_read_ranges(datagram.data(), datagram.size(), key.data(), &told) || told.count == 0)
      return std::nullopt;
    std::int64_t newest_us = told.range[0].offset_us;
    for (unsigned i = 1; i < told.count; ++i)
      newest_us = std::max<std::int64_t>(newest_us, told.range[i].offset_us);
    return world_.module(from).moment_of(told.epoch,
                                         static_cast<std::int64_t>(told.time_ns) + 1000 * newest_us);
  }

  void deliver(std::uint16_t from, const std::vector<std::uint8_t>& datagram, std::optional<Femto> measured) {
    const Station& station = stations_.at(from);
    station.socket.send(datagram);
    std::cout << "sent " << air::to_seconds(world_.events().now()) << ' ' << from << ' ' << datagram.size()
              << ' ';
    if (measured)
      std::cout << air::to_seconds(*measured);
    else
      std::cout << '-';
    std::cout << '\n' << std::flush;
    std::string answer;
    if (!std::getline(std::cin, answer)) throw Abandoned();
    for (auto& [address, other] : stations_) carry_down(address, other);
  }

  void carry_down(std::uint16_t to, Station& station) {
    while (true) {
      std::vector<std::uint8_t> datagram = station.socket.receive();
      if (datagram.empty()) return;
      station.down = arrival(station, station.down);
      air::Board& board = world_.module(to).board();
      world_.events().at(station.down, [&board, sent = std::move(datagram)] { board.hear(sent); });
    }
  }

  air::World& world_;
  std::map<std::uint16_t, Station> stations_;
};

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

Scenario load(const std::string& path) {
  std::ifstream text(path);
  if (!text) throw UsageError(path + " cannot be read");
  return read_scenario(text, path);
}

void run(const Options& options) {
  const Scenario scenario = load(options.scenario);
  air::World world(scenario.settings);
  for (const air::Module::Spec& node : scenario.nodes) world.add(node);
  for (const Scenario::Late& late : scenario.late)
    world.medium().block(late.a, late.b, late.begin, late.end, late.extra_m);

  std::cout << std::fixed << std::setprecision(9);
  const Network network(world, scenario.settings, options.port);
  world.on_state = [&world](std::uint16_t module, std::string_view words) {
    std::cout << "said " << air::to_seconds(world.events().now()) << " node " << module << ' ' << words
              << '\n';
  };
  if (options.frames) world.medium().on_emission = tell_frame;
  world.run_until(scenario.length);
  std::cout << "done" << '\n' << std::flush;
}

int fail(const std::exception& error, int status) {
  std::cerr << "synchronizar-air: " << error.what() << '\n';
  return status;
}

}  // namespace

int main(int argc, char* const* argv) {
  try {
    run(read_options(argc, argv));
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
