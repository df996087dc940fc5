#include "avatar/bridge.hpp"

#include <fmt/format.h>
#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <random>
#include <string>
#include <system_error>
#include <thread>
#include <utility>

#include "avatar/bridge_destination.hpp"
#include "avatar/bridge_messages.hpp"
#include "avatar/mapping_file.hpp"
#include "avatar/phone_requests.hpp"
#include "avatar/vrchat_finder.hpp"
#include "avatar/vts_link.hpp"
#include "facet/aside.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "files/output_file.hpp"

namespace facet::avatar {
namespace {

/// After so many that went well, what failed before is told no more.
constexpr int kSoundFrames = 30;
/// Of targets that asked.
constexpr std::size_t kMostAskers = 16;
/// So many frames that were refused, none of them followed by kSoundFrames that were not: the asker is gone.
constexpr int kMostRefusals = 20;

/// A UUID by lot (RFC 4122, version 4): 36 characters.
std::string random_uuid() {
  std::random_device random;
  std::uniform_int_distribution<unsigned> digit(0, 15);
  std::string uuid = "xxxxxxxx-xxxx-4xxx-8xxx-xxxxxxxxxxxx";
  for (char& c : uuid) {
    c = c == 'x' ? "0123456789ABCDEF"[digit(random)] : c;
  }
  return uuid;
}

}  // namespace

const char* to_string(NeutralState state) {
  switch (state) {
    case NeutralState::None:
      return "none";
    case NeutralState::Recording:
      return "recording";
    case NeutralState::Set:
      return "set";
    case NeutralState::Failed:
      return "failed";
  }
  return "";
}

struct Bridge::Impl {
  Impl(const BridgeConfig& given, LookUp given_look_up);

  // What holds poses stands first: it is aligned to 32 bytes.
  Smoother smoother;                         ///< the thread's own
  ValueTuner tuner FACET_GUARDED_BY(mutex);  ///< of the live frames that complete() is given
  ValueTuner shown FACET_GUARDED_BY(mutex);  ///< of takes and poses, between which live frames come
  std::optional<NeutralPose> neutral FACET_GUARDED_BY(mutex);
  std::optional<NeutralRecorder> recorder FACET_GUARDED_BY(mutex);  ///< while a neutral pose is recorded

  BridgeMessages messages;     ///< the thread's own
  MappedValues vts_chosen;     ///< likewise
  MappedValues vrchat_chosen;  ///< likewise
  BridgeConfig config;
  LookUp look_up;
  using Destination = BridgeDestination;
  /// The thread's own, as is status.targets' order: the configured ones, then those that asked or were found.
  std::vector<Destination> destinations;

  mutable Mutex mutex;
  Condition changed;
  bool stopping FACET_GUARDED_BY(mutex) = false;
  bool saving FACET_GUARDED_BY(mutex) = false;                            ///< what was recorded is written
  bool cleared FACET_GUARDED_BY(mutex) = false;                           ///< while it was written
  bool remapped FACET_GUARDED_BY(mutex) = false;                          ///< `messages` have another one yet
  std::shared_ptr<const mesh::MeshFrame> newest FACET_GUARDED_BY(mutex);  ///< not sent yet
  BridgeStatus status FACET_GUARDED_BY(mutex);
  std::shared_ptr<const ValueTunings> values FACET_GUARDED_BY(mutex);  ///< those of the status
  ValueMapping mapping FACET_GUARDED_BY(mutex);                        ///< its values are not used
  mesh::ArkitValues sent FACET_GUARDED_BY(mutex){};
  Clock::time_point recorded_until FACET_GUARDED_BY(mutex);

  // The thread's own. Between begin and wait `sought` is the helper's.
  struct Sought {
    std::size_t target;
    LookedUp found;
  };
  std::vector<Sought> sought;
  std::atomic<bool> seeking = false;
  Clock::time_point next_look_up = Clock::now();
  std::optional<PhoneRequests> requests;
  Clock::time_point next_listening = Clock::now();
  std::optional<std::uint64_t> found_changes = 0;  ///< those of the finder's that were taken; none: again

  VtsTokens tokens{config.vts_tokens_file};
  struct PluginTarget {
    std::size_t target;  ///< of config.targets
    std::unique_ptr<VtsLink> link;
  };
  std::vector<PluginTarget> plugins;
  std::unique_ptr<VrChatFinder> finder;  ///< none: VRChats are not looked for

  // Last, so that they are joined before anything is freed; the helper after who asks it.
  Aside names{"facet-names", [this] { look_up_sought(); }};
  std::jthread thread;

  void settle(std::size_t target, const LookedUp& found, BridgeTargetStatus& told);
  void look_up_again() FACET_REQUIRES(mutex);
  void look_up_sought();
  // Without the lock, which they take where they change the status: nobody waits for what the network brings.
  void hear_requests();
  bool has_place() const;
  void take_asker(const Asker& asker);
  void forget_askers();
  void take_mapping(const ValueMapping& fresh);
  void take_found();
  void know(std::size_t place, const FoundVrChat* vrchat);
  void add(Destination destination, BridgeTargetStatus told);
  void forget(std::size_t place);
  bool changes_values() const FACET_REQUIRES(mutex) { return recorder || neutral || !values->plain(); }
  void run();
  void work_once(Clock::time_point& next_send) FACET_REQUIRES(mutex);
  void finish_recording() FACET_REQUIRES(mutex);
  void send(const FaceState& state, bool with_neutral);
};

Bridge::Impl::Impl(const BridgeConfig& given, LookUp given_look_up)
    : smoother(static_cast<float>(given.smoothing_ms * 1e-3)),
      messages(random_uuid(), given.subject, {given.vmc_shapes, given.vmc_eye_bones}),
      config(given),
      look_up(std::move(given_look_up)),
      mapping(load_mapping(given.mapping_file)) {
  messages.map(mapping);
  vts_chosen = mapping.vtube_studio;
  vrchat_chosen = mapping.vrchat;
  status.tokens_reason = tokens.fault();
  try {
    neutral = load_neutral(config.neutral_file);
  } catch (const Error& error) {
    // A file that a power cut left empty must not keep the daemon from its work.
    status.neutral_reason = fmt::format("{}; {}", error.what(), files::set_aside(config.neutral_file));
  }
  status.neutral = neutral ? NeutralState::Set : NeutralState::None;
  status.values = mapping.values.value_or(config.values);
  values = std::make_shared<const ValueTunings>(status.values);
  destinations.resize(config.targets.size());
  for (std::size_t i = 0; i < destinations.size(); ++i) {
    const BridgeTarget& target = config.targets[i];
    destinations[i].target = target;
    BridgeTargetStatus told{.target = target};
    if (target.protocol == BridgeProtocol::VTubeStudioPlugin) {
      plugins.push_back({i, std::make_unique<VtsLink>(target, tokens, look_up)});
      status.targets.push_back(std::move(told));
      continue;
    }
    const SocketAddress digits = socket_address(target.address, target.port);
    settle(i, digits.length > 0 ? LookedUp{digits, ""} : look_up(target), told);
    status.targets.push_back(std::move(told));
  }
  if (config.find.where != VrChatFind::Off) {
    finder = std::make_unique<VrChatFinder>(config.find);
  }
  // So that one who comes is on both lists or on none, even where there is no memory.
  const std::size_t most = config.targets.size() + kMostAskers + kMostFoundVrChats;
  destinations.reserve(most);
  status.targets.reserve(most);
  next_look_up = Clock::now() + config.look_up_every;
}

/// Takes what a target's address is, or why it has none.
void Bridge::Impl::settle(std::size_t target, const LookedUp& found, BridgeTargetStatus& told) {
  Destination& destination = destinations[target];
  destination.unknown.clear();
  if (found.address.length == 0) {
    destination.unknown = fmt::format("{}; it is looked up again every {:.3g} s", found.trouble,
                                      std::chrono::duration<double>(config.look_up_every).count());
  } else {
    destination.address = found.address;
    destination.open();
  }
  told.reason = destination.unknown;
}

/// Asks for names that were not found, and takes answers. Where no helper can be made there are none.
void Bridge::Impl::look_up_again() {
  if (names.begun()) {
    if (!names.ready()) {
      return;
    }
    names.wait();
    next_look_up = Clock::now() + config.look_up_every;
    for (const Sought& each : sought) {
      settle(each.target, each.found, status.targets[each.target]);
    }
    found_changes.reset();  // one of them may be a VRChat that was found
  } else if (Clock::now() >= next_look_up) {
    sought.clear();
    for (std::size_t i = 0; i < config.targets.size(); ++i) {
      if (!destinations[i].socket && config.targets[i].protocol != BridgeProtocol::VTubeStudioPlugin) {
        sought.push_back({i, {}});
      }
    }
    if (sought.empty()) {
      next_look_up = Clock::time_point::max();
    } else {
      seeking = true;
      names.begin();
      if (!names.helped()) {
        seeking = false;
      }
    }
  }
}

void Bridge::Impl::look_up_sought() {
  for (Sought& each : sought) {
    try {
      each.found = look_up(config.targets[each.target]);
    } catch (const std::exception& error) {
      each.found = {{}, error.what()};
    }
  }
  seeking = false;
}

/// Listens where it is to and can, and takes who asks.
void Bridge::Impl::hear_requests() {
  const auto now = Clock::now();
  if (now >= next_listening && (!requests || !requests->fault().empty())) {
    requests.reset();  // its ports are free for the next
    requests.emplace(config.answer);
    next_listening = now + config.look_up_every;
    const Lock lock(mutex);
    status.answer_reason = requests->fault();
  }
  // Once all places are taken, only those who have one are heard.
  const auto welcome = [&](const SocketAddress& from) {
    return has_place() ||
           std::any_of(destinations.begin(), destinations.end(),
                       [&](const Destination& known) { return same_host(known.address, from); });
  };
  requests->hear(welcome, [&](const Asker& asker) { take_asker(asker); });
  forget_askers();
}

void Bridge::Impl::take_asker(const Asker& asker) {
  const auto until = Clock::now() + asker.lasting;
  for (Destination& known : destinations) {
    if (known.target.protocol == asker.protocol && same_address(known.address, asker.address)) {
      known.until = known.until ? std::optional(until) : std::nullopt;
      known.version = asker.version;
      return;
    }
  }
  if (!has_place()) {
    return;
  }
  Destination asked;
  asked.target = asker.target();
  asked.address = asker.address;
  asked.until = until;
  asked.version = asker.version;
  BridgeTargetStatus told{.target = asked.target, .asked = true};
  add(std::move(asked), std::move(told));
}

/// One that is not configured. Whoever says that he is somebody else gets nothing beyond this network.
void Bridge::Impl::add(Destination destination, BridgeTargetStatus told) {
  destination.open();
  if (!keep_in_network(destination.socket.get(), destination.address.storage.ss_family)) {
    return;
  }
  const Lock lock(mutex);
  status.targets.push_back(std::move(told));
  destinations.push_back(std::move(destination));
}

void Bridge::Impl::forget(std::size_t place) {
  const auto at = static_cast<std::ptrdiff_t>(place);
  destinations.erase(destinations.begin() + at);
  const Lock lock(mutex);
  status.targets.erase(status.targets.begin() + at);
}

void Bridge::Impl::forget_askers() {
  const auto now = Clock::now();
  for (std::size_t i = destinations.size(); i > config.targets.size(); --i) {
    const Destination& asked = destinations[i - 1];
    if (asked.until && (now >= *asked.until || asked.refusals >= kMostRefusals)) {
      forget(i - 1);
    }
  }
}

bool Bridge::Impl::has_place() const {
  const auto askers = std::count_if(destinations.begin(), destinations.end(),
                                    [](const Destination& each) { return each.until.has_value(); });
  return static_cast<std::size_t>(askers) < kMostAskers;
}

void Bridge::Impl::take_mapping(const ValueMapping& fresh) {
  messages.map(fresh);
  vts_chosen = fresh.vtube_studio;
  vrchat_chosen = fresh.vrchat;
  for (std::size_t i = 0; i < destinations.size(); ++i) {
    Destination& each = destinations[i];
    if (each.avatar != nullptr) {
      each.wear(each.avatar, vrchat_chosen);
      const Lock lock(mutex);
      status.targets[i].driven = each.writer->driven();
    }
  }
}

/// Takes over which VRChats answer, where that has changed.
void Bridge::Impl::take_found() {
  const std::uint64_t changes = finder->changes();
  if (changes == found_changes) {
    return;
  }
  found_changes = changes;
  const std::vector<FoundVrChat> found = finder->found();
  const auto is_at = [](const FoundVrChat& vrchat, const Destination& destination) {
    return destination.target.protocol == BridgeProtocol::VrChat &&
           std::any_of(vrchat.addresses.begin(), vrchat.addresses.end(), [&](const SocketAddress& address) {
             return same_address(address, destination.address);
           });
  };
  for (std::size_t i = destinations.size(); i > 0; --i) {
    const Destination& known = destinations[i - 1];
    const auto vrchat =
        std::find_if(found.begin(), found.end(), [&](const FoundVrChat& each) { return is_at(each, known); });
    const auto configured = [&](const Destination& other) { return !other.found && is_at(*vrchat, other); };
    if (known.found &&
        (vrchat == found.end() || std::any_of(destinations.begin(), destinations.end(), configured))) {
      forget(i - 1);
    } else if (known.target.protocol == BridgeProtocol::VrChat) {
      know(i - 1, vrchat != found.end() ? &*vrchat : nullptr);
    }
  }
  for (const FoundVrChat& vrchat : found) {
    if (std::none_of(destinations.begin(), destinations.end(),
                     [&](const Destination& known) { return is_at(vrchat, known); })) {
      Destination place;
      place.target = vrchat.target();
      place.address = vrchat.addresses.front();
      place.found = true;
      BridgeTargetStatus told{.target = place.target, .found = true};
      const std::size_t before = destinations.size();
      try {
        add(std::move(place), std::move(told));
      } catch (const Error&) {
        // Want of descriptors, which may pass.
      }
      if (destinations.size() > before) {
        know(before, &vrchat);
      } else {
        found_changes.reset();
      }
    }
  }
}

/// What a target of VRChat's is, and what its avatar has; null: that is not known.
void Bridge::Impl::know(std::size_t place, const FoundVrChat* vrchat) {
  Destination& destination = destinations[place];
  const auto avatar = vrchat != nullptr ? vrchat->avatar : nullptr;
  if (avatar != destination.avatar) {
    destination.wear(avatar, vrchat_chosen);
  }
  const Lock lock(mutex);
  BridgeTargetStatus& told = status.targets[place];
  told.name = vrchat != nullptr ? vrchat->name : "";
  told.avatar = avatar != nullptr ? avatar->avatar : "";
  told.driven = avatar != nullptr ? std::optional(destination.writer->driven()) : std::nullopt;
}

void Bridge::Impl::run() {
  ::pthread_setname_np(::pthread_self(), "facet-bridge");
  Clock::time_point next_send = Clock::now();
  const Lock lock(mutex);
  while (!stopping) {
    try {
      work_once(next_send);
    } catch (const std::exception& error) {
      // A frame for which there was no memory: the next one finds some, or not.
      for (BridgeTargetStatus& target : status.targets) {
        ++target.failed;
        target.reason = error.what();
      }
    }
  }
}

/// Waits for a frame or the time to send it, sends it, or ends the recording of a neutral pose.
void Bridge::Impl::work_once(Clock::time_point& next_send) {
  const auto period =
      std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(1 / config.rate_hz));
  look_up_again();
  if (!config.answer.empty() || finder != nullptr) {
    {
      const Unlock unlock(mutex);
      if (!config.answer.empty()) {
        hear_requests();
      }
      if (finder != nullptr) {
        take_found();
      }
    }
    if (stopping) {
      return;  // told while nobody waited
    }
  }
  const auto now = Clock::now();
  if (recorder && now >= recorded_until) {
    finish_recording();
  }
  if (newest == nullptr || now < next_send) {
    // A recording ends without a frame too.
    const auto until = newest != nullptr ? next_send : now + std::chrono::milliseconds(100);
    changed.wait_until(mutex, Clock::wake(until));
    return;
  }
  // A frame that comes a little early is in time all the same: a camera at rate_hz loses none.
  next_send = std::max(next_send + period, now - period / 2);
  const auto frame = std::exchange(newest, nullptr);
  FaceState state = face_state(*frame);
  if (state.tracked && !frame->avatar_values.empty()) {
    state.values = mesh::arkit_values(frame->subject->expression_names, frame->avatar_values);
  }
  const bool with_neutral = neutral.has_value();
  if (neutral && state.tracked) {
    subtract_head(*neutral, state);
  }
  const std::optional<ValueMapping> fresh =
      std::exchange(remapped, false) ? std::optional(mapping) : std::nullopt;
  {
    const Unlock unlock(mutex);
    if (fresh) {
      take_mapping(*fresh);
    }
    smoother.apply(state);
    send(state, with_neutral);
  }
  sent = state.values;
}

/// Writes the file with the lock open: whoever hands frames over does not wait for the disk.
void Bridge::Impl::finish_recording() {
  const NeutralRecorder recorded = *std::exchange(recorder, std::nullopt);
  std::optional<NeutralPose> mean;
  std::string fault;
  saving = true;
  cleared = false;
  {
    const Unlock unlock(mutex);
    mean = recorded.mean();
    if (mean) {
      try {
        save_neutral(*mean, config.neutral_file);
      } catch (const Error& error) {
        fault = error.what();
      }
    } else {
      fault = fmt::format("a face was tracked in {} frames, {} are needed", recorded.frames(),
                          NeutralRecorder::kFewestFrames);
    }
  }
  saving = false;
  if (cleared) {
    std::error_code ignored;
    std::filesystem::remove(config.neutral_file, ignored);  // as was asked while it was written
    return;
  }
  status.neutral = fault.empty() ? NeutralState::Set : NeutralState::Failed;
  status.neutral_reason = fault;
  status.neutral_frames = recorded.frames();
  if (fault.empty()) {
    neutral = mean;
  }
}

void Bridge::Impl::send(const FaceState& state, bool with_neutral) {
  if (!plugins.empty()) {
    const auto parameters =
        std::make_shared<const VtsParameters>(vts_parameters(state, vts_chosen, config.vts_arkit));
    for (const PluginTarget& plugin : plugins) {
      plugin.link->publish(parameters);
    }
  }
  messages.begin(state, with_neutral);
  for (std::size_t i = 0; i < destinations.size(); ++i) {
    VrChatWriter* const writer = destinations[i].writer.get();
    const auto& datagrams = writer != nullptr
                                ? messages.of(*writer)
                                : messages.of(destinations[i].target.protocol, destinations[i].version);
    if (datagrams.empty()) {
      continue;
    }
    const std::string reason = destinations[i].send(datagrams);
    const Lock lock(mutex);
    BridgeTargetStatus& target = status.targets[i];
    ++target.frames;
    target.failed += reason.empty() ? 0 : 1;
    // Where nobody listens, every second datagram is refused: those between went out, to nobody.
    Destination& destination = destinations[i];
    destination.sound_frames = reason.empty() ? destination.sound_frames + 1 : 0;
    const bool sound = destination.sound_frames >= kSoundFrames;
    destination.refusals = sound ? 0 : destination.refusals + (reason.empty() ? 0 : 1);
    if (!reason.empty() || sound) {
      target.reason = reason;
    }
  }
}

Bridge::Bridge(const BridgeConfig& config, LookUp look_up)
    : impl_(std::make_unique<Impl>(config, std::move(look_up))) {}

Bridge::~Bridge() {
  request_stop();
  stop();
}

void Bridge::start() {
  for (const Impl::PluginTarget& plugin : impl_->plugins) {
    plugin.link->start();
  }
  if (impl_->finder != nullptr) {
    impl_->finder->start();
  }
  impl_->thread = std::jthread([this] { impl_->run(); });
}

void Bridge::request_stop() {
  {
    const Lock lock(impl_->mutex);
    impl_->stopping = true;
  }
  impl_->changed.notify_one();
  for (const Impl::PluginTarget& plugin : impl_->plugins) {
    plugin.link->request_stop();
  }
  if (impl_->finder != nullptr) {
    impl_->finder->request_stop();
  }
}

void Bridge::stop() {
  if (impl_->thread.joinable()) {
    impl_->thread.join();
  }
  for (const Impl::PluginTarget& plugin : impl_->plugins) {
    plugin.link->stop();
  }
  if (impl_->finder != nullptr) {
    impl_->finder->stop();
  }
}

bool Bridge::finished() const {
  return !impl_->seeking && std::all_of(impl_->plugins.begin(), impl_->plugins.end(),
                                        [](const auto& plugin) { return plugin.link->finished(); });
}

void Bridge::complete(mesh::MeshFrame& frame) {
  frame.avatar_values.clear();
  const Lock lock(impl_->mutex);
  if (!impl_->changes_values()) {
    return;
  }
  FaceState state = face_state(frame);
  const bool live = frame.origin == mesh::Origin::Live;
  if (impl_->recorder && live) {
    impl_->recorder->add(state);
    impl_->status.neutral_frames = impl_->recorder->frames();
  }
  if (impl_->neutral && state.tracked) {
    subtract_values(*impl_->neutral, state);
  }
  (live ? impl_->tuner : impl_->shown).apply(*impl_->values, state);
  if (state.tracked && state.has_expression) {
    values_to_frame(state.values, frame);
  }
}

bool Bridge::changes_values() const {
  const Lock lock(impl_->mutex);
  return impl_->changes_values();
}

void Bridge::publish(std::shared_ptr<const mesh::MeshFrame> frame) {
  {
    const Lock lock(impl_->mutex);
    impl_->newest.swap(frame);
  }
  impl_->changed.notify_one();
}

BridgeStatus Bridge::status() const {
  BridgeStatus now;
  {
    const Lock lock(impl_->mutex);
    now = impl_->status;
  }
  for (const Impl::PluginTarget& plugin : impl_->plugins) {
    const VtsLinkStatus link = plugin.link->status();
    BridgeTargetStatus& target = now.targets[plugin.target];
    target.frames = link.frames;
    target.failed = link.failed;
    target.reason = link.reason;
  }
  if (impl_->finder != nullptr) {
    now.find_reason = impl_->finder->fault();
  }
  return now;
}

void Bridge::record_neutral(std::chrono::milliseconds duration) {
  const Lock lock(impl_->mutex);
  if (impl_->recorder || impl_->saving) {
    throw Error(ErrorKind::Usage, "a neutral pose is being recorded already");
  }
  impl_->recorder.emplace();
  impl_->recorded_until = Clock::now() + duration;
  impl_->status.neutral = NeutralState::Recording;
  impl_->status.neutral_reason.clear();
  impl_->status.neutral_frames = 0;
}

void Bridge::clear_neutral() {
  std::error_code failure;
  std::filesystem::remove(impl_->config.neutral_file, failure);
  if (failure) {
    throw Error(ErrorKind::Storage, fmt::format("cannot remove '{}': {}", impl_->config.neutral_file.string(),
                                                failure.message()));
  }
  const Lock lock(impl_->mutex);
  impl_->recorder.reset();
  impl_->cleared = true;
  impl_->neutral.reset();
  impl_->status.neutral = NeutralState::None;
  impl_->status.neutral_reason.clear();
}

void Bridge::tune(const ValueTunings& values) {
  auto taken = std::make_shared<const ValueTunings>(values);
  const Lock lock(impl_->mutex);
  impl_->status.values = values;
  impl_->values.swap(taken);
}

void Bridge::map(const ValueMapping& mapping) {
  const Lock lock(impl_->mutex);
  impl_->mapping = mapping;
  impl_->remapped = true;
}

ValueMapping Bridge::mapping() const {
  const Lock lock(impl_->mutex);
  ValueMapping now = impl_->mapping;
  now.values = impl_->status.values;
  return now;
}

mesh::ArkitValues Bridge::sent_values() const {
  const Lock lock(impl_->mutex);
  return impl_->sent;
}

}  // namespace facet::avatar
