#include "firmware/targets/host/scenario.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <limits>
#include <map>
#include <set>

#include "firmware/targets/host/words.h"

extern "C" {
#include "firmware/core/timetable.h"
}

namespace {

using air::Femto;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

class Reader {
 public:
  explicit Reader(bool settings_alone) : settings_alone_(settings_alone) {
    scenario_.settings.node.scheme = SCHEME_ONE_TO_N;
    scenario_.settings.node.channel = 5;
    scenario_.settings.node.prf_mhz = 64;
  }

  Scenario read(std::istream& text, const std::string& file) {
    std::string line;
    int number = 0;
    try {
      while (std::getline(text, line)) {
        ++number;
        Words words(line);
        if (number == 1)
          read_version(words);
        else
          read_line(words);
        words.end();
      }
      ++number;
      check_complete(number == 1);
    } catch (const std::invalid_argument& fault) {
      throw ScenarioError(file + ":" + std::to_string(number) + ": " + fault.what());
    }
    return scenario_;
  }

 private:
  static void read_version(Words& words) {
    words.expect("air");
    words.expect("1");
  }

  void read_line(Words& words) {
    const std::string kind = words.next("what the line is about");
    if (!settings_alone_) {
      if (kind == "node") return read_node(words);
      if (kind == "key") return read_key(words);
      if (kind == "at") return read_place(words);
      if (kind == "late") return read_late(words);
    }
    if (!said_.insert(kind).second) throw std::invalid_argument("'" + kind + "' stands here once more");
    read_setting(kind, words);
  }

  void read_setting(const std::string& kind, Words& words) {
    air::Medium::Settings& medium = scenario_.settings.medium;
    struct node_settings& node = scenario_.settings.node;
    constexpr auto most32 = std::numeric_limits<std::uint32_t>::max();
    if (kind == "seed") {
      medium.seed = words.whole("the seed", std::numeric_limits<std::uint64_t>::max());
    } else if (kind == "seconds" && !settings_alone_) {
      scenario_.length = words.time("the length");
    } else if (kind == "scheme") {
      node.scheme = scheme_of(words.next("the scheme"));
    } else if (kind == "session") {
      node.session = static_cast<std::uint32_t>(words.whole("the session", most32));
    } else if (kind == "channel") {
      node.channel = static_cast<std::uint8_t>(one_of("the channel", {1, 2, 3, 4, 5, 7}, words));
    } else if (kind == "prf") {
      node.prf_mhz = static_cast<std::uint8_t>(one_of("the PRF", {16, 64}, words));
    } else if (kind == "range_s") {
      node.range_s = static_cast<std::uint32_t>(words.whole("range_s", most32));
    } else if (kind == "sleep_s") {
      node.sleep_s = static_cast<std::uint32_t>(words.whole("sleep_s", most32));
    } else if (kind == "stamp_sigma") {
      medium.stamp_sigma_m = words.number("stamp_sigma", 0.0, 10.0);
    } else if (kind == "frame_loss") {
      medium.frame_loss = words.number("frame_loss", 0.0, 1.0);
    } else {
      throw std::invalid_argument("'" + kind + "' is unknown");
    }
  }

  static std::uint8_t scheme_of(const std::string& word) {
    if (word == "one-to-n") return SCHEME_ONE_TO_N;
    if (word == "all-pairs") return SCHEME_ALL_PAIRS;
    if (word == "polling") return SCHEME_POLLING;
    throw std::invalid_argument("the scheme is '" + word + "', not one-to-n, all-pairs or polling");
  }

  static std::uint64_t one_of(const char* what, const std::set<std::uint64_t>& allowed, Words& words) {
    const std::uint64_t value = words.whole(what, *allowed.rbegin());
    if (allowed.count(value) == 0)
      throw std::invalid_argument(std::string(what) + " cannot be " + std::to_string(value));
    return value;
  }

  void read_key(Words& words) {
    air::Module::Spec& node = known(words.address());
    if (!keys_.insert(node.address).second)
      throw std::invalid_argument("node " + std::to_string(node.address) + " has a key already");
    node.key = words.key();
  }

  void read_node(Words& words) {
    const std::uint16_t address = words.address();
    air::Module::Stint stint;
    words.crystals(stint);
    words.expect("on");
    stint.on = words.time("on");
    words.expect("off");
    const double off_s = words.number("off", 0.0, kInfinity);
    stint.off = off_s > Words::kLongestS ? air::Module::kForever : air::seconds(off_s);
    words.radio(stint);

    if (stint.off <= stint.on) throw std::invalid_argument("power goes off before it goes on");
    const auto [found, is_new] = index_.try_emplace(address, scenario_.nodes.size());
    if (is_new) scenario_.nodes.emplace_back().address = address;
    auto& stints = scenario_.nodes[found->second].stints;
    if (!stints.empty() && stint.on < stints.back().off)
      throw std::invalid_argument("node " + std::to_string(address) + " still has power then");
    stints.push_back(stint);
  }

  air::Module::Spec& known(std::uint16_t address) {
    const auto found = index_.find(address);
    if (found == index_.end())
      throw std::invalid_argument("there is no node " + std::to_string(address) + " yet");
    return scenario_.nodes[found->second];
  }

  void read_place(Words& words) {
    air::Track& track = known(words.address()).track;
    const Femto t = words.time("the time");
    track.add(t, words.position());
  }

  void read_late(Words& words) {
    Scenario::Late late;
    late.a = known(words.address()).address;
    late.b = known(words.address()).address;
    words.span(late);
    Femto& late_until = late_until_[std::minmax({late.a, late.b})];
    if (late.begin < late_until) throw std::invalid_argument("signals between the two are late already then");
    late_until = late.end;
    scenario_.late.push_back(late);
  }

  void check_complete(bool empty) const {
    if (empty) throw std::invalid_argument("nothing stands here");
    for (const char* kind : {"seconds", "session"}) {
      const bool needed = !settings_alone_ || kind != std::string("seconds");
      if (needed && said_.count(kind) == 0)
        throw std::invalid_argument(std::string("'") + kind + "' is missing");
    }
    if (settings_alone_) return;
    if (scenario_.nodes.empty()) throw std::invalid_argument("there is no node");
    for (const air::Module::Spec& node : scenario_.nodes) {
      const std::string name = "node " + std::to_string(node.address);
      if (keys_.count(node.address) == 0) throw std::invalid_argument(name + " has no 'key'");
      if (node.track.empty()) throw std::invalid_argument(name + " is nowhere: it has no 'at'");
    }
  }

  const bool settings_alone_;
  Scenario scenario_;
  std::set<std::string> said_;
  std::map<std::uint16_t, std::size_t> index_;  // of a node, by address
  std::set<std::uint16_t> keys_;                // of whom there is one
  std::map<std::pair<std::uint16_t, std::uint16_t>, Femto> late_until_;
};

}  // namespace

Scenario read_scenario(std::istream& text, const std::string& file) { return Reader(false).read(text, file); }

air::World::Settings read_settings(std::istream& text, const std::string& file) {
  return Reader(true).read(text, file).settings;
}
