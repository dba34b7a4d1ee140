// The DW1000 at its registers, as its user manual 2.10 tells them, with its pitfalls. Simulated time passes
// in Events; the radio's counter is its crystal's.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "firmware/sim/chip_registers.h"
#include "firmware/sim/chip_tuning.h"
#include "firmware/sim/crystal.h"
#include "firmware/sim/dice.h"
#include "firmware/sim/events.h"
#include "firmware/sim/radio.h"

namespace air {

class Chip {
 public:
  // `tx_delay`, `rx_delay`: what the antenna and its way really take, in femtoseconds.
  struct Nature {
    double ppm = 0.0;
    Femto tx_delay = 0, rx_delay = 0;
    double temperature_c = 23.0;
    std::uint64_t seed = 0;
  };

  // Both outlive it, and it outlives what it has asked of `events`.
  Chip(Events& events, Ether& ether, const Nature& nature);
  Chip(const Chip&) = delete;
  Chip& operator=(const Chip&) = delete;

  // The host's side. A transaction happens at events.now(), header and data at once; `hz` is the SPI clock.
  void spi(const std::uint8_t* header, std::size_t header_size, std::uint8_t* data, std::size_t size,
           double hz);
  void reset();                        // RSTn pulsed
  void select_for(Femto time);         // chip select was low so long until now, without a clock
  void power(bool on);                 // off: everything is forgotten
  bool interrupt() const;              // the level of its line
  std::function<void()> on_interrupt;  // called when the line rises

  // The air's side: called when an arrival's preamble begins.
  void hear(const Arrival& arrival);

  Crystal& crystal() { return crystal_; }
  const Crystal& crystal() const { return crystal_; }
  void set_delays(Femto tx_delay, Femto rx_delay);
  void set_temperature(double c) { nature_.temperature_c = c; }

  // What a host did that the manual forbids, or that this model does not know, in words; with how often,
  // where more than once.
  const std::vector<std::string>& complaints() const { return complaints_; }
  bool asleep() const { return power_ == Power::kAsleep; }

 private:
  enum class Power {
    kOff,
    kAsleep,
    kWaking,  // its crystal begins to swing
    kInit,    // runs by the crystal alone
    kOn,      // its PLL has locked
  };
  enum class Radio {
    kIdle,
    kSendLater,  // a frame waits for its moment
    kSend,
    kListenLater,  // the receiver waits for its moment
    kTurnOn,
    kListen,
    kReceive,  // a preamble has been found
  };
  enum class Damage { kNone, kHeader, kData, kCheck };  // by a collision: what fails of the frame

  struct Heard {
    std::uint32_t serial;
    Arrival arrival;
  };
  struct Sending {
    Tuned tuned;
    std::size_t offset = 0, size = 0;  // in TX_BUFFER; with the FCS
    std::uint64_t marker = 0;          // ticks when the RMARKER leaves the digital part
    bool own_fcs = false;              // the host brings it
    bool then_listen = false;
  };
  struct Receiving {
    Arrival arrival;
    Damage damage = Damage::kNone;
    int symbols = 0;          // of the preamble that came in
    std::uint64_t stamp = 0;  // ticks
  };

  // chip.cpp: power, the host's side, what registers do.
  void begin();
  void lock();
  void fall_asleep();
  void forget();               // what is going on
  void forget_all();           // what the always-on block keeps, too
  bool crystal_clock() const;  // the digital part runs by the crystal, and the SPI slowly
  std::uint8_t corrupted(std::uint8_t byte);
  void read(const SpiHeader& header, std::uint8_t* data, std::size_t size);
  void write(const SpiHeader& header, const std::uint8_t* data, std::size_t size, bool corrupt);
  void after_write(std::uint8_t file, std::size_t begin, std::size_t end);
  void configure();
  std::uint8_t temperature_reading() const;
  void convert_temperature();
  void control_always_on();
  std::uint32_t otp(std::uint64_t address) const;
  void control_otp();
  void load_microcode();
  void control_power(std::uint64_t before);
  void set_status(std::uint64_t bits);
  void clear_status(std::uint64_t bits);
  void update_line();
  void complain(const std::string& what);

  // chip_radio.cpp: sending and receiving.
  void command(std::uint64_t bits);
  bool ready_to(const char* what);
  void stop_radio();
  std::uint64_t counter() const;
  Femto moment_of(std::uint64_t ticks) const;
  void start_to_send(bool delayed, bool own_fcs, bool then_listen);
  void warn_of_half_period(std::uint64_t moment);
  void end_half_period_warning();
  void begin_preamble();
  void preamble_sent();
  void header_sent();
  void frame_sent();
  void start_to_listen(bool delayed);
  void turn_receiver_on();
  void listen();
  void hunt(const Heard& heard);
  Femto clear_from(const Heard& heard) const;
  void found_preamble(std::uint32_t serial);
  void collide(const Arrival& other);
  void found_sfd();
  void stamp();
  void received_header();
  void received_data();
  void fail(std::uint64_t status, bool needs_reset);
  void preamble_timed_out();
  void sfd_timed_out();
  void frame_timed_out();
  void report(const Arrival& arrival);
  std::uint64_t frame_information(std::size_t size);

  // Asks for a step of the radio, which falls away when the radio stops before.
  template <void (Chip::*kStep)()>
  void radio_at(Femto t) {
    events_.at(t, [this, epoch = radio_epoch_] {
      if (epoch == radio_epoch_) (this->*kStep)();
    });
  }
  // The same of power.
  template <void (Chip::*kStep)()>
  void power_at(Femto t) {
    events_.at(t, [this, epoch = power_epoch_] {
      if (epoch == power_epoch_) (this->*kStep)();
    });
  }

  Events& events_;
  Ether& ether_;
  Nature nature_;
  Dice random_;
  Crystal crystal_;
  std::vector<std::string> complaints_;
  std::vector<std::pair<std::string, std::uint64_t>> complained_;  // the same without and with their counts

  Power power_ = Power::kOff;
  std::uint32_t power_epoch_ = 0;
  Registers registers_;
  std::uint64_t status_ = 0;  // SYS_STATUS
  bool line_ = false;
  bool microcode_ = false;  // of the LDE is loaded
  bool microcode_loading_ = false;

  // The one-time programmable memory, and what the always-on memory holds.
  std::uint32_t otp_ldo_tune_ = 0;
  std::uint8_t otp_temperature_ = 0, otp_voltage_ = 0, otp_crystal_trim_ = 0;
  Registers saved_;
  std::uint64_t aon_wake_ = 0, aon_sleep_ = 0;  // AON_WCFG and AON_CFG0 as uploaded

  Radio radio_ = Radio::kIdle;
  std::uint32_t radio_epoch_ = 0;
  Sending sending_;
  Receiving receiving_;
  std::vector<Heard> air_;  // what is on the air here
  std::uint32_t serial_ = 0;
  Femto listening_since_ = 0;
  double loss_db_ = 0.0;      // of sensitivity, as the receiver is tuned
  bool needs_reset_ = false;  // the receiver, or its next stamp is wrong
};

}  // namespace air
