// The network between modules and their collector: Wi-Fi in simulated time, real UDP datagrams at its end.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <vector>

#include "firmware/sim/dice.h"
#include "firmware/sim/world.h"

namespace air {

// A module's way to the collector, with a port of its own: what the collector sends back there is for that
// module.
class Socket {
 public:
  explicit Socket(std::uint16_t collector_port);
  ~Socket();
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;

  // Nobody may be listening; then the datagram is lost, as it would be on a network.
  void send(const std::vector<std::uint8_t>& datagram) const;
  // What has come in by now; empty: nothing.
  std::vector<std::uint8_t> receive() const;

 private:
  int handle_;
};

class Network {
 public:
  // `on_sent`: a datagram has just been sent to the collector; when the newest of its ranges was measured.
  using OnSent = std::function<void(std::uint16_t from, std::size_t size, std::optional<Femto> measured)>;

  // Of all modules that are in the world and will be.
  Network(World& world, std::uint64_t seed, std::uint16_t port, OnSent on_sent);

  // What the collector has sent by now is on its way to the modules.
  void carry_down();

 private:
  struct Station {
    Station(const Dice& some_dice, std::uint16_t port) : dice(some_dice), socket(port) {}
    Dice dice;
    Socket socket;
    Femto up = 0, down = 0;  // when the latest datagram comes there
  };

  Station& station_of(std::uint16_t address);
  Femto arrival(Station& station, Femto latest);
  void carry_up(std::uint16_t from, std::vector<std::uint8_t> datagram);
  std::optional<Femto> newest_measured(std::uint16_t from, const std::vector<std::uint8_t>& datagram) const;

  World& world_;
  const std::uint64_t seed_;
  const std::uint16_t port_;
  const OnSent on_sent_;
  std::map<std::uint16_t, Station> stations_;
};

}  // namespace air
