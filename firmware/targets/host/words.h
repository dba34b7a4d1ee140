// Words of a line, as scenarios and whoever steers the live air write them.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <sstream>
#include <stdexcept>
#include <string>

#include "firmware/sim/world.h"
#include "firmware/targets/host/scenario.h"

// Reads a line's words one after the other, and throws what is wrong with them in words of its own
// (std::invalid_argument).
class Words {
 public:
  static constexpr double kLongestS = 1e9;  // thirty years

  explicit Words(const std::string& line) : in_(line) {}

  std::string next(const char* what) {
    std::string word;
    if (!(in_ >> word)) throw std::invalid_argument(std::string(what) + " is missing");
    return word;
  }

  void expect(const char* word) {
    const std::string found = next(word);
    if (found != word) throw std::invalid_argument("'" + found + "' stands where '" + word + "' is expected");
  }

  double number(const char* what, double least, double most) {
    const std::string word = next(what);
    char* end = nullptr;
    const double value = std::strtod(word.c_str(), &end);
    if (*end != '\0') throw std::invalid_argument(std::string(what) + " is '" + word + "', not a number");
    if (!(least <= value && value <= most)) {
      std::ostringstream fault;
      fault << what << " is " << word << ", not from " << least << " to " << most;
      throw std::invalid_argument(fault.str());
    }
    return value;
  }

  std::uint64_t whole(const char* what, std::uint64_t most) {
    const std::string word = next(what);
    const bool digits = std::all_of(word.begin(), word.end(), [](char c) { return '0' <= c && c <= '9'; });
    const bool fits = digits && word.size() <= 20;
    const std::uint64_t value = fits ? std::strtoull(word.c_str(), nullptr, 10) : 0;
    if (!fits || value > most || std::to_string(value) != word)
      throw std::invalid_argument(std::string(what) + " is '" + word + "', not a whole number up to " +
                                  std::to_string(most));
    return value;
  }

  air::Femto time(const char* what) { return air::seconds(number(what, 0.0, kLongestS)); }

  std::uint16_t address() { return static_cast<std::uint16_t>(whole("the address", 65533)); }

  air::Position position() {
    air::Position position{};
    for (double& x : position) x = number("a coordinate", -kFarthestM, kFarthestM);
    return position;
  }

  air::Module::Key key() {
    const std::string word = next("the key");
    air::Module::Key key{};
    if (word.size() != 2 * key.size() ||
        word.find_first_not_of("0123456789abcdefABCDEF") != std::string::npos)
      throw std::invalid_argument("the key is not " + std::to_string(2 * key.size()) + " hexadecimal digits");
    for (std::size_t i = 0; i < key.size(); ++i)
      key[i] = static_cast<std::uint8_t>(std::stoi(word.substr(2 * i, 2), nullptr, 16));
    return key;
  }

  void crystals(air::Module::Stint& stint) {
    expect("ppm");
    stint.ppm = number("ppm", -kWorstPpm, kWorstPpm);
    expect("board_ppm");
    stint.board_ppm = number("board_ppm", -kWorstPpm, kWorstPpm);
  }

  void radio(air::Module::Stint& stint) {
    expect("antenna_delay_error");
    stint.antenna_delay_error_m = number("antenna_delay_error", -kMostDelayM, kMostDelayM);
    expect("temperature");
    stint.temperature_c = number("temperature", -40.0, 85.0);  // all that a DWM1000 stands
  }

  // What follows the two ends of a span in which signals come late.
  void span(Scenario::Late& late) {
    late.begin = time("the begin");
    late.end = time("the end");
    late.extra_m = number("the detour", 0.0, kFarthestM);
    if (late.a == late.b) throw std::invalid_argument("both ends are node " + std::to_string(late.a));
    if (late.end <= late.begin) throw std::invalid_argument("it ends before it begins");
  }

  void end() {
    std::string word;
    if (in_ >> word) throw std::invalid_argument("'" + word + "' is too much");
  }

 private:
  static constexpr double kFarthestM = 1e6;    // from the origin
  static constexpr double kWorstPpm = 100.0;   // no crystal is as bad as that
  static constexpr double kMostDelayM = 10.0;  // nor is a calibration

  std::istringstream in_;
};
