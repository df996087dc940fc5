#include "stream/places.hpp"

#include <algorithm>
#include <iterator>
#include <tuple>

#include "facet/assert.hpp"
#include "facet/clock.hpp"

namespace facet::stream {

Places::Places(const PlacesConfig& config) : config_(config) {}

/// A bucket that fills again with time.
bool Places::may_connect(const std::string& peer, Clock::time_point now) {
  if (config_.connects_at_once <= 0) {
    return true;
  }
  const double most = config_.connects_at_once;
  const auto regained = [&](const Connects& entry) {
    const double seconds = std::chrono::duration<double>(now - entry.counted).count();
    return std::min(most, entry.left + std::max(0.0, seconds) * config_.connects_per_s);
  };
  // Those whose bucket is full again are forgotten, so that the list stays as short as the peers are few.
  std::erase_if(connects_, [&](const auto& entry) { return regained(entry.second) >= most; });
  Connects& own = connects_.try_emplace(peer, Connects{most, now}).first->second;
  own = {regained(own), now};
  FACET_ASSERT(own.left >= 0 && own.left <= most, own.left, most);
  if (own.left < 1) {
    return false;
  }
  own.left -= 1;
  return true;
}

bool Places::gives_way(const Holder& holder, const Visitor& visitor, Clock::time_point now) const {
  if (visitor.may_command && (!holder.visitor.may_command || !holder.was_used)) {
    return true;
  }
  if (holder.visitor.may_command && !visitor.may_command) {
    return false;
  }
  return now - holder.last_use >= (holder.was_used ? config_.idle_keeps : config_.unused_keeps);
}

/// Those who may only look come first, then those who never used their place.
template <typename Allowed>
Places::Holders::iterator Places::longest_idle(Allowed allowed) {
  const auto rank = [](const Holder& holder) {
    return std::tuple(holder.visitor.may_command, holder.was_used, holder.last_use);
  };
  auto found = holders_.end();
  for (auto entry = holders_.begin(); entry != holders_.end(); ++entry) {
    if (allowed(entry->second) && (found == holders_.end() || rank(entry->second) < rank(found->second))) {
      found = entry;
    }
  }
  return found;
}

Places::Outcome Places::enter(Id id, const Visitor& visitor, Clock::time_point now) {
  if (!visitor.may_command && !may_connect(visitor.peer, now)) {
    return {Answer::TooManyConnects, std::nullopt};
  }
  const auto of_peer = [&](const Holder& holder) {
    return !holder.visitor.may_command && holder.visitor.peer == visitor.peer;
  };
  const auto looks = [](const Holder& holder) { return !holder.visitor.may_command; };
  const auto count = [&](const auto& holds) {
    return static_cast<std::size_t>(std::count_if(holders_.begin(), holders_.end(),
                                                  [&](const auto& entry) { return holds(entry.second); }));
  };
  const bool peer_has_all = !visitor.may_command && count(of_peer) >= config_.per_peer;
  const std::size_t for_lookers = config_.total - std::min(config_.reserved, config_.total);
  const bool full = holders_.size() >= config_.total || (!visitor.may_command && count(looks) >= for_lookers);
  Outcome outcome;
  if (peer_has_all || full) {
    // A peer that has all that are due to it makes room among its own.
    const auto found = longest_idle([&](const Holder& holder) {
      return gives_way(holder, visitor, now) && (!peer_has_all || of_peer(holder));
    });
    if (found == holders_.end()) {
      return {peer_has_all ? Answer::TooManyOfPeer : Answer::NoPlace, std::nullopt};
    }
    outcome.gives_way = found->first;
    holders_.erase(found);
  }
  FACET_ASSERT(!holders_.contains(id) && holders_.size() < config_.total, id, holders_.size(), config_.total);
  holders_.insert_or_assign(id, Holder{visitor, false, now});
  return outcome;
}

void Places::used(Id id, Clock::time_point now) {
  if (const auto found = holders_.find(id); found != holders_.end()) {
    found->second.was_used = true;
    found->second.last_use = now;
  }
}

void Places::leave(Id id) {
  holders_.erase(id);
}

const char* to_string(Places::Answer answer) {
  switch (answer) {
    case Places::Answer::Admitted:
      return "admitted";
    case Places::Answer::NoPlace:
      return "all places are taken, and none of them is idle";
    case Places::Answer::TooManyOfPeer:
      return "this peer has as many places as one may have";
    case Places::Answer::TooManyConnects:
      return "this peer connects too often";
  }
  return "";
}

}  // namespace facet::stream
