#include "firmware/targets/host/live.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace air {

namespace {

constexpr Femto kForgetEvery = kSecond;
// Where somebody was is asked no later than a frame is long after they were there, and where they will be no
// earlier than that.
constexpr Femto kFrame = kMillisecond;

std::string name_of(std::uint16_t address) { return "module " + std::to_string(address); }

}  // namespace

void Live::take(const std::string& line) {
  Words words(line);
  const std::string kind = words.next("what the line is about");
  if (kind == "module") return add(words);
  if (kind == "at") return place(words);
  if (kind == "blocked") return block(words);
  if (kind != "stay" && kind != "off") throw std::invalid_argument("'" + kind + "' is unknown");
  const std::uint16_t address = words.address();
  words.end();
  if (kind == "stay") return stay(address);
  remove(address);
}

void Live::add(Words& words) {
  const std::uint16_t address = words.address();
  Carried carried;
  carried.key = words.key();
  words.crystals(carried.stint);
  words.radio(carried.stint);
  words.end();
  if (carried_.count(address) > 0) throw std::invalid_argument(name_of(address) + " is there already");
  const auto before = world_.modules().find(address);
  if (before != world_.modules().end() && before->second->key() != carried.key)
    throw std::invalid_argument(name_of(address) + " had another key before");
  carried_.emplace(address, std::move(carried));
}

void Live::place(Words& words) {
  const std::uint16_t address = words.address();
  const Femto t = words.time("the time");
  const Position position = words.position();
  words.end();
  Carried& carried = known(address);
  Track& track = carried.track();
  if (!track.empty() && t <= track.newest())
    throw std::invalid_argument("the times of " + name_of(address) + " must rise");
  if (carried.stays) {
    carried.stays = false;
    const Femto now = world_.events().now();
    if (now > track.newest()) track.add(now, track.at(now));  // it was at rest until now
    if (t <= now) return;                                     // and this place comes too late
  }
  track.add(t, position);
}

void Live::block(Words& words) {
  Scenario::Late late;
  late.a = words.address();
  late.b = words.address();
  words.span(late);
  words.end();
  world_.medium().block(late.a, late.b, late.begin, late.end, late.extra_m);
}

void Live::stay(std::uint16_t address) {
  Carried& carried = known(address);
  if (carried.track().empty()) throw std::invalid_argument(name_of(address) + " is nowhere yet");
  carried.stays = true;
}

void Live::remove(std::uint16_t address) {
  const Carried& carried = known(address);
  if (carried.module != nullptr) carried.module->switch_off();
  carried_.erase(address);
}

Live::Carried& Live::known(std::uint16_t address) {
  const auto found = carried_.find(address);
  if (found == carried_.end()) throw std::invalid_argument("there is no " + name_of(address));
  return found->second;
}

std::optional<Femto> Live::horizon() const {
  std::optional<Femto> least;
  for (const auto& [address, carried] : carried_) {
    if (carried.stays || carried.track().empty()) continue;
    const Femto known_until = carried.track().newest() - kFrame;
    least = least ? std::min(*least, known_until) : known_until;
  }
  if (least) least = std::max(*least, world_.events().now());
  return least;
}

void Live::run_until(Femto t) {
  const std::optional<Femto> most = horizon();
  if (!most) return;
  t = std::min(t, *most);
  while (true) {
    switch_on_who_is_there();
    const Femto next = next_to_come(t);
    if (next > world_.events().now()) world_.run_until(next);
    if (next >= t) break;
  }
  forget();
}

void Live::switch_on_who_is_there() {
  const Femto now = world_.events().now();
  for (auto& [address, carried] : carried_) {
    if (carried.module != nullptr || carried.before.empty() || carried.before.oldest() > now) continue;
    // One that comes later than others have gone on is nowhere until it has caught up with them.
    if (!carried.stays && carried.before.newest() < now + kFrame) continue;
    const bool again = world_.modules().count(address) > 0;
    carried.module =
        again ? &world_.module(address) : &world_.add({address, carried.before, {}, carried.key});
    carried.module->track() = std::move(carried.before);
    carried.module->switch_on(carried.stint);
  }
}

Femto Live::next_to_come(Femto until) const {
  Femto next = until;
  for (const auto& [address, carried] : carried_)
    if (carried.module == nullptr && !carried.before.empty() &&
        carried.before.oldest() > world_.events().now())
      next = std::min(next, carried.before.oldest());
  return next;
}

void Live::forget() {
  const Femto before = world_.events().now() - kFrame;
  if (before < forgotten_ + kForgetEvery) return;
  forgotten_ = before;
  for (auto& [address, carried] : carried_) carried.track().forget_before(before);
  world_.medium().forget_before(before);
}

}  // namespace air
