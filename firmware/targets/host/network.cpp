#include "firmware/targets/host/network.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <system_error>
#include <utility>

extern "C" {
#include "firmware/core/wire.h"
}

namespace air {

namespace {

// From a module to the collector over Wi-Fi and back: at least 1.5 ms, and 1.5 ms more on average. So an
// access point that is not busy behaves while the stations' power save is off (assumed). One station's
// datagrams do not overtake each other.
constexpr double kWifiLeastS = 1.5e-3, kWifiMoreS = 1.5e-3;
constexpr std::uint64_t kWifiDice = 0xF1;

constexpr std::size_t kLargest = 2048;

}  // namespace

Socket::Socket(std::uint16_t collector_port) : handle_(::socket(AF_INET, SOCK_DGRAM, 0)) {
  sockaddr_in collector{};
  collector.sin_family = AF_INET;
  collector.sin_port = htons(collector_port);
  collector.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (handle_ < 0 || ::connect(handle_, reinterpret_cast<const sockaddr*>(&collector), sizeof collector) != 0)
    throw std::system_error(errno, std::generic_category(), "no socket");
}

Socket::~Socket() { ::close(handle_); }

void Socket::send(const std::vector<std::uint8_t>& datagram) const {
  (void)::send(handle_, datagram.data(), datagram.size(), 0);
}

std::vector<std::uint8_t> Socket::receive() const {
  std::vector<std::uint8_t> datagram(kLargest);
  const ssize_t size = ::recv(handle_, datagram.data(), datagram.size(), MSG_DONTWAIT);
  datagram.resize(size > 0 ? static_cast<std::size_t>(size) : 0);
  return datagram;
}

Network::Network(World& world, std::uint64_t seed, std::uint16_t port, OnSent on_sent)
    : world_(world), seed_(seed), port_(port), on_sent_(std::move(on_sent)) {
  world.on_datagram = [this](std::uint16_t from, const std::uint8_t* datagram, std::size_t size) {
    carry_up(from, {datagram, datagram + size});
    return true;
  };
}

Network::Station& Network::station_of(std::uint16_t address) {
  return stations_.try_emplace(address, Dice{seed_, kWifiDice, address}, port_).first->second;
}

Femto Network::arrival(Station& station, Femto latest) {
  const Femto latency = seconds(kWifiLeastS + kWifiMoreS * station.dice.exponential());
  return std::max(world_.events().now() + latency, latest);
}

void Network::carry_up(std::uint16_t from, std::vector<std::uint8_t> datagram) {
  Station& station = station_of(from);
  station.up = arrival(station, station.up);
  const std::optional<Femto> measured = newest_measured(from, datagram);
  world_.events().at(station.up, [this, from, &station, measured, sent = std::move(datagram)] {
    station.socket.send(sent);
    on_sent_(from, sent.size(), measured);
  });
}

// As the module has its time now.
std::optional<Femto> Network::newest_measured(std::uint16_t from,
                                              const std::vector<std::uint8_t>& datagram) const {
  struct wire_ranges told;
  const Module::Key& key = world_.module(from).key();
  if (!wire_read_ranges(datagram.data(), datagram.size(), key.data(), &told) || told.count == 0)
    return std::nullopt;
  std::int64_t newest_us = told.range[0].offset_us;
  for (unsigned i = 1; i < told.count; ++i)
    newest_us = std::max<std::int64_t>(newest_us, told.range[i].offset_us);
  return world_.module(from).moment_of(told.epoch,
                                       static_cast<std::int64_t>(told.time_ns) + 1000 * newest_us);
}

void Network::carry_down() {
  for (auto& [address, station] : stations_) {
    while (true) {
      std::vector<std::uint8_t> datagram = station.socket.receive();
      if (datagram.empty()) break;
      station.down = arrival(station, station.down);
      Board& board = world_.module(address).board();
      world_.events().at(station.down, [&board, sent = std::move(datagram)] { board.hear(sent); });
    }
  }
}

}  // namespace air
