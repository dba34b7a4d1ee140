// The scenario's text: what it means, and that each fault is named with its line.
#include <sstream>
#include <string>
#include <vector>

#include "firmware/targets/host/scenario.h"
#include "tests/cpp/check.h"

extern "C" {
#include "firmware/core/timetable.h"
}

namespace {

using air::kMillisecond;
using air::kSecond;

const char* const kKey1 = "key 1 000102030405060708090a0b0c0d0e0f101112131415161718191A1B1C1D1E1F\n";
const char* const kKey2 = "key 2 ff0102030405060708090a0b0c0d0e0f101112131415161718191A1B1C1D1E1F\n";
const char* const kBegin = "air 1\nseconds 30\nsession 4294967295\n";
const char* const kNode1 =
    "node 1 ppm 3.5 board_ppm -10 on 0 off 20 antenna_delay_error 0.1 temperature 30\n";
const char* const kNode2 = "node 2 ppm 0 board_ppm 0 on 0.5 off inf antenna_delay_error 0 temperature 23\n";

Scenario read(const std::string& text) {
  std::istringstream in(text);
  return read_scenario(in, "room.txt");
}

// The fault found in a scenario; empty: none.
std::string fault(const std::string& text) {
  try {
    (void)read(text);
  } catch (const ScenarioError& error) {
    return error.what();
  }
  return "";
}

// Two nodes with all that they need, on lines 1 to 9.
std::string whole() {
  return std::string(kBegin) + kNode1 + kKey1 + kNode2 + kKey2 + "at 1 0 0 0 1.5\nat 2 0 1 2 3\n";
}

// The fault of a line after those, which is line 10.
std::string fault_of(const std::string& line) { return fault(whole() + line + "\n"); }

void a_scenario_says_what_is_to_be_simulated() {
  const Scenario scenario =
      read(whole() +
           "seed 18446744073709551615\nscheme polling\nchannel 2\nprf 16\nrange_s 10\nsleep_s 300\n"
           "stamp_sigma 0.03\nframe_loss 0.25\nat 1 10.5 4 5 -6\nlate 2 1 3 4.25 1.5\n"
           "node 1 ppm 4 board_ppm 0 on 20 off 25 antenna_delay_error -0.1 temperature -5\n");
  CHECK(scenario.length == 30 * kSecond);
  CHECK(scenario.settings.medium.seed == UINT64_MAX);
  CHECK_NEAR(scenario.settings.medium.stamp_sigma_m, 0.03, 0.0);
  CHECK_NEAR(scenario.settings.medium.frame_loss, 0.25, 0.0);
  const struct node_settings& node = scenario.settings.node;
  CHECK(node.session == UINT32_MAX);
  CHECK(node.scheme == SCHEME_POLLING);
  CHECK(node.channel == 2 && node.prf_mhz == 16);
  CHECK(node.range_s == 10 && node.sleep_s == 300);

  CHECK(scenario.nodes.size() == 2);
  const air::Module::Spec& first = scenario.nodes.at(0);
  CHECK(first.address == 1);
  for (std::size_t i = 0; i < 32; ++i) {
    CHECK_NEAR(first.key.at(i), static_cast<double>(i), 0.0);
    CHECK_NEAR(scenario.nodes.at(1).key.at(i), i == 0 ? 255.0 : static_cast<double>(i), 0.0);
  }
  CHECK(first.stints.size() == 2);
  CHECK(first.stints.at(0).on == 0 && first.stints.at(0).off == 20 * kSecond);
  CHECK_NEAR(first.stints.at(0).ppm, 3.5, 0.0);
  CHECK_NEAR(first.stints.at(0).board_ppm, -10.0, 0.0);
  CHECK_NEAR(first.stints.at(0).antenna_delay_error_m, 0.1, 0.0);
  CHECK_NEAR(first.stints.at(0).temperature_c, 30.0, 0.0);
  CHECK(first.stints.at(1).on == 20 * kSecond && first.stints.at(1).off == 25 * kSecond);
  CHECK_NEAR(first.stints.at(1).temperature_c, -5.0, 0.0);
  CHECK_NEAR(first.track.at(5250 * kMillisecond)[0], 2.0, 1e-12);
  CHECK_NEAR(first.track.at(99 * kSecond)[2], -6.0, 0.0);
  CHECK(scenario.nodes.at(1).stints.at(0).off == air::Module::kForever);

  CHECK(scenario.late.size() == 1);
  CHECK(scenario.late.at(0).a == 2 && scenario.late.at(0).b == 1);
  CHECK(scenario.late.at(0).begin == 3 * kSecond && scenario.late.at(0).end == 4250 * kMillisecond);
  CHECK_NEAR(scenario.late.at(0).extra_m, 1.5, 0.0);
}

void what_is_not_said_is_as_the_description_has_it() {
  const Scenario scenario = read(whole());
  const struct node_settings& node = scenario.settings.node;
  CHECK(node.scheme == SCHEME_ONE_TO_N && node.channel == 5 && node.prf_mhz == 64);
  CHECK(node.range_s == 0 && node.sleep_s == 0);
  CHECK(scenario.settings.medium.seed == 0);
  CHECK_NEAR(scenario.settings.medium.stamp_sigma_m, 0.0, 0.0);
  CHECK_NEAR(scenario.settings.medium.frame_loss, 0.0, 0.0);
}

struct Fault {
  std::string line, words;
};

void each_fault_is_named_with_its_line() {
  const std::vector<Fault> faults = {
      {"", "what the line is about is missing"},
      {"sed 1", "'sed' is unknown"},
      {"air 1", "'air' is unknown"},
      {"seconds 30", "'seconds' stands here once more"},
      {"seed", "the seed is missing"},
      {"seed -1", "the seed is '-1', not a whole number up to 18446744073709551615"},
      {"seed 18446744073709551616",
       "the seed is '18446744073709551616', not a whole number up to 18446744073709551615"},
      {"seed 1 2", "'2' is too much"},
      {"scheme one_to_n", "the scheme is 'one_to_n', not one-to-n, all-pairs or polling"},
      {"channel 6", "the channel cannot be 6"},
      {"prf 65", "the PRF is '65', not a whole number up to 64"},
      {"range_s 1.5", "range_s is '1.5', not a whole number up to 4294967295"},
      {"stamp_sigma x", "stamp_sigma is 'x', not a number"},
      {"stamp_sigma -0.1", "stamp_sigma is -0.1, not from 0 to 10"},
      {"frame_loss 1.01", "frame_loss is 1.01, not from 0 to 1"},
      {"frame_loss nan", "frame_loss is nan, not from 0 to 1"},
      {"node 65534 ppm 0", "the address is '65534', not a whole number up to 65533"},
      {"node 3 pm 0", "'pm' stands where 'ppm' is expected"},
      {"node 3 ppm 101 board_ppm 0", "ppm is 101, not from -100 to 100"},
      {"node 3 ppm 0 board_ppm 0 on inf off inf", "on is inf, not from 0 to 1e+09"},
      {"node 3 ppm 0 board_ppm 0 on 0 off 1 antenna_delay_error 0 temperature 99",
       "temperature is 99, not from -40 to 85"},
      {"node 3 ppm 0 board_ppm 0 on 2 off 2 antenna_delay_error 0 temperature 9",
       "power goes off before it goes on"},
      {"node 1 ppm 0 board_ppm 0 on 19 off 22 antenna_delay_error 0 temperature 9",
       "node 1 still has power then"},
      {"node 2 ppm 0 board_ppm 0 on 19 off 22 antenna_delay_error 0 temperature 9",
       "node 2 still has power then"},
      {"node 3 ppm 0 board_ppm 0 on 2 off 3 antenna_delay_error 0 temperature", "temperature is missing"},
      {"at 3 0 0 0 0", "there is no node 3 yet"},
      {"at 1 0 0 0 0", "a track's times must rise"},
      {"at 1 1 0 0", "a coordinate is missing"},
      {"at 1 1 0 0 inf", "a coordinate is inf, not from -1e+06 to 1e+06"},
      {"at 1 -1 0 0 0", "the time is -1, not from 0 to 1e+09"},
      {"key 3 00", "there is no node 3 yet"},
      {"key 1 00", "node 1 has a key already"},
      {"late 1 3 0 1 2", "there is no node 3 yet"},
      {"late 1 1 0 1 2", "both ends are node 1"},
      {"late 1 2 1 1 2", "it ends before it begins"},
      {"late 1 2 0 1 -2", "the detour is -2, not from 0 to 1e+06"},
  };
  for (const Fault& expected : faults) {
    const std::string found = fault_of(expected.line);
    if (found != "room.txt:10: " + expected.words)
      std::cerr << "'" << expected.line << "': " << found << '\n';
    CHECK(found == "room.txt:10: " + expected.words);
  }
}

void late_spans_of_two_nodes_must_not_overlap() {
  CHECK(fault_of("late 1 2 1 2 1\nlate 2 1 2 3 1").empty());
  CHECK(fault_of("late 1 2 1 2 1\nlate 2 1 1.5 3 1") ==
        "room.txt:11: signals between the two are late already then");
}

void a_short_key_is_refused() {
  const std::string node = std::string("air 1\n") + kNode1;
  CHECK(fault(node + "key 1 00ff\n") == "room.txt:3: the key is not 64 hexadecimal digits");
  CHECK(fault(node + "key 1 " + std::string(64, 'g') + "\n") ==
        "room.txt:3: the key is not 64 hexadecimal digits");
}

void another_version_is_refused() {
  CHECK(fault("air 2\n") == "room.txt:1: '2' stands where '1' is expected");
  CHECK(fault("seed 1\n") == "room.txt:1: 'seed' stands where 'air' is expected");
  CHECK(fault("") == "room.txt:1: nothing stands here");
}

void what_is_missing_is_named_at_the_end() {
  CHECK(fault("air 1\n") == "room.txt:2: 'seconds' is missing");
  CHECK(fault("air 1\nseconds 1\n") == "room.txt:3: 'session' is missing");
  CHECK(fault(kBegin) == "room.txt:4: there is no node");
  CHECK(fault(std::string(kBegin) + kNode1) == "room.txt:5: node 1 has no 'key'");
  CHECK(fault(std::string(kBegin) + kNode1 + kKey1) == "room.txt:6: node 1 is nowhere: it has no 'at'");
}

// Of the live air: what holds for all, and nothing of the modules, which come later.
void settings_stand_alone() {
  const auto settings_of = [](const std::string& text) {
    std::istringstream in(text);
    return read_settings(in, "live.txt");
  };
  const air::World::Settings settings = settings_of("air 1\nsession 7\nseed 3\nstamp_sigma 0.03\n");
  CHECK(settings.node.session == 7 && settings.medium.seed == 3);
  const std::vector<std::pair<std::string, std::string>> faults = {
      {"air 1\n", "live.txt:2: 'session' is missing"},
      {"air 1\nsession 7\nseconds 3\n", "live.txt:3: 'seconds' is unknown"},
      {std::string("air 1\nsession 7\n") + kNode1, "live.txt:3: 'node' is unknown"},
  };
  for (const auto& [text, words] : faults) {
    std::string found;
    try {
      (void)settings_of(text);
    } catch (const ScenarioError& error) {
      found = error.what();
    }
    CHECK(found == words);
  }
}

}  // namespace

int main() {
  a_scenario_says_what_is_to_be_simulated();
  what_is_not_said_is_as_the_description_has_it();
  each_fault_is_named_with_its_line();
  late_spans_of_two_nodes_must_not_overlap();
  a_short_key_is_refused();
  another_version_is_refused();
  what_is_missing_is_named_at_the_end();
  settings_stand_alone();
  return check::verdict();
}
