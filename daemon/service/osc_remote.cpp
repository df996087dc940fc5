#include "service/osc_remote.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <exception>
#include <limits>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "service/listen_address.hpp"
#include "stream/unix_socket.hpp"
#include "take/notes.hpp"
#include "take/take_file.hpp"

namespace facet::service {
namespace {

constexpr std::chrono::seconds kOpenPeriod{10};
constexpr std::chrono::seconds kComplaintPeriod{10};
/// In one round of the loop.
constexpr int kMostPackets = 64;
constexpr int kMostUnderWay = 8;
constexpr std::size_t kMostSlateBytes = 80;

template <typename Value>
const Value* argument(const OscMessage& message, std::size_t index) {
  return index < message.arguments.size() ? std::get_if<Value>(&message.arguments[index]) : nullptr;
}

in_port_t* port_of(sockaddr_storage& address) {
  return address.ss_family == AF_INET6 ? &reinterpret_cast<sockaddr_in6*>(&address)->sin6_port
                                       : &reinterpret_cast<sockaddr_in*>(&address)->sin_port;
}

/// In digits, as inet_pton takes them; IPv4 as such, though "[::]" hears it as ::ffff:A.B.C.D.
std::string host_of(const sockaddr_storage& address) {
  const auto& v4 = reinterpret_cast<const sockaddr_in&>(address);
  const auto& v6 = reinterpret_cast<const sockaddr_in6&>(address);
  int family = address.ss_family;
  const void* bytes = &v4.sin_addr;
  if (family == AF_INET6) {
    const bool mapped = IN6_IS_ADDR_V4MAPPED(&v6.sin6_addr);
    family = mapped ? AF_INET : AF_INET6;
    bytes = &v6.sin6_addr.s6_addr[mapped ? 12 : 0];
  }
  std::array<char, INET6_ADDRSTRLEN> text{};
  return ::inet_ntop(family, bytes, text.data(), text.size()) != nullptr ? text.data() : "";
}

/// How many bytes the character has that begins a text; 0 where none does (RFC 3629).
std::size_t character_bytes(std::string_view text) {
  const auto byte = [&](std::size_t i) {
    return i < text.size() ? static_cast<unsigned char>(text[i]) : static_cast<unsigned char>(0);
  };
  const unsigned char lead = byte(0);
  if (lead < 0x80) {
    return 1;
  }
  const std::size_t bytes = lead < 0xC2 || lead > 0xF4 ? 0 : lead < 0xE0 ? 2 : lead < 0xF0 ? 3 : 4;
  for (std::size_t i = 1; i < bytes; ++i) {
    if ((byte(i) & 0xC0U) != 0x80U) {
      return 0;
    }
  }
  // Written longer than it need be, half of a pair, beyond the last.
  const unsigned char second = byte(1);
  const bool none = (lead == 0xE0 && second < 0xA0) || (lead == 0xED && second > 0x9F) ||
                    (lead == 0xF0 && second < 0x90) || (lead == 0xF4 && second > 0x8F);
  return none ? 0 : bytes;
}

/// Of a take's `meta`, as a reader has them. slate: UTF-8.
take::MetaEntries slate_entries(const std::string& slate, std::int32_t number) {
  const take::TakeNotes notes = take::notes_of([&](std::string_view key) {
    return key == "scene" ? slate : key == "scene_take" ? std::to_string(number) : std::string();
  });
  return slate.empty() ? take::MetaEntries()
                       : take::MetaEntries{{"scene", notes.scene}, {"scene_take", notes.number}};
}

}  // namespace

struct OscRemote::Door {
  explicit Door(const Log& given) : log(given) {}

  const Log& log;
  stream::FileDescriptor fd;
  std::atomic<int> under_way{0};  ///< begins and ends of takes that wait for the disk
  Mutex mutex;
  Clock::time_point complained FACET_GUARDED_BY(mutex);
  std::uint64_t complaints FACET_GUARDED_BY(mutex) = 0;  ///< since then

  void complain(const std::string& what);
};

/// Any thread.
void OscRemote::Door::complain(const std::string& what) {
  const Lock lock(mutex);
  ++complaints;
  const auto now = Clock::now();
  if (now - complained >= kComplaintPeriod) {
    log.warning(complaints > 1 ? fmt::format("OSC: {} ({} such messages since the last of these lines)", what,
                                             complaints)
                               : "OSC: " + what,
                {{"FACET_EVENT", "osc"}});
    complained = now;
    complaints = 0;
  }
}

/// Where a confirmation goes.
struct OscRemote::Answer {
  std::shared_ptr<Door> door;
  sockaddr_storage to{};
  socklen_t length = 0;

  /// One that is lost is nobody's fault: UDP.
  void send(const OscMessage& message) const {
    const auto packet = osc_packet(message);
    ::sendto(door->fd.get(), packet.data(), packet.size(), MSG_DONTWAIT | MSG_NOSIGNAL,
             reinterpret_cast<const sockaddr*>(&to), length);
  }
};

OscRemote::OscRemote(OscConfig config, Desk desk, const Log& log)
    : config_(std::move(config)), desk_(std::move(desk)), log_(log) {}

OscRemote::~OscRemote() = default;

void OscRemote::open() {
  const auto address = resolve_listen(config_.listen);
  if (address == nullptr) {
    throw Error(ErrorKind::Unavailable, fmt::format("osc.listen: \"{}\" is no address", config_.listen));
  }
  auto door = std::make_shared<Door>(log_);
  door->fd = stream::FileDescriptor(
      ::socket(address->ai_family, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, IPPROTO_UDP));
  if (!door->fd || ::bind(door->fd.get(), address->ai_addr, address->ai_addrlen) != 0) {
    throw Error(ErrorKind::Unavailable,
                fmt::format("cannot listen for OSC on {}: {}", config_.listen, std::strerror(errno)));
  }
  door_ = std::move(door);
  log_.info(fmt::format("OSC on {}", config_.listen));
  if (config_.is_public) {
    log_.warning("osc.public: whoever reaches its address can begin and end takes");
  }
}

void OscRemote::look_after() {
  const auto now = Clock::now();
  if (config_.listen.empty() || door_ != nullptr || now < open_due_) {
    return;
  }
  open_due_ = now + kOpenPeriod;
  try {
    open();
  } catch (const Error& error) {
    if (open_fault_ != error.what()) {
      log_.warning(error.what());
    }
    open_fault_ = error.what();
  }
}

int OscRemote::fd() const {
  return door_ != nullptr ? door_->fd.get() : -1;
}

void OscRemote::serve() {
  std::array<std::byte, kMostOscBytes> packet;
  for (int i = 0; door_ != nullptr && i < kMostPackets; ++i) {
    sockaddr_storage from{};
    socklen_t length = sizeof(from);
    const ssize_t bytes = ::recvfrom(door_->fd.get(), packet.data(), packet.size(), MSG_TRUNC,
                                     reinterpret_cast<sockaddr*>(&from), &length);
    if (bytes < 0) {
      return;
    }
    if (std::cmp_greater(bytes, packet.size())) {
      door_->complain("a packet is longer than 4096 bytes");
      continue;
    }
    take_packet(std::span(packet).first(static_cast<std::size_t>(bytes)), from, length);
  }
}

void OscRemote::take_packet(std::span<const std::byte> packet, const sockaddr_storage& from,
                            socklen_t length) {
  const auto messages = parse_osc(packet);
  if (!messages) {
    door_->complain(fmt::format("a packet of {} is none", host_of(from)));
    return;
  }
  for (const OscMessage& message : *messages) {
    if (message.address == "/OSCSetSendTarget") {
      set_target(message, from, length);
      continue;
    }
    const bool named = target_port_ && host_of(target_) == host_of(from);
    Answer answer{door_, from, length};
    if (named) {
      *port_of(answer.to) = htons(*target_port_);
    }
    obey(message, answer);
  }
}

/// Only for the sender's own address: nobody's packets are turned on others.
void OscRemote::set_target(const OscMessage& message, const sockaddr_storage& from, socklen_t length) {
  const auto* host = argument<std::string>(message, 0);
  const auto* port = argument<std::int32_t>(message, 1);
  if (host == nullptr || port == nullptr || *port < 1 || *port > 65535) {
    door_->complain("/OSCSetSendTarget needs an address and a port");
    return;
  }
  if (*host != host_of(from)) {
    door_->complain(
        fmt::format("{} asks that answers go to {}: they go to who asks alone", host_of(from), *host));
    return;
  }
  target_ = from;
  target_port_ = static_cast<std::uint16_t>(*port);
  Answer answer{door_, from, length};
  *port_of(answer.to) = htons(*target_port_);
  answer.send({"/OSCSetSendTargetConfirm", {}});
}

void OscRemote::obey(const OscMessage& message, const Answer& answer) {
  if (message.address == "/Slate") {
    if (const auto* slate = argument<std::string>(message, 0)) {
      slate_ = as_utf8(*slate);
    }
  } else if (message.address == "/Take") {
    if (const auto* number = argument<std::int32_t>(message, 0)) {
      take_number_ = std::make_shared<std::int32_t>(*number);
    }
  } else if (message.address == "/RecordStart") {
    begin(message, answer);
  } else if (message.address == "/RecordStop") {
    ask("/RecordStop", answer, [desk = desk_]() -> OscMessage {
      const take::RecorderStatus take = desk.recording.stop();
      const std::filesystem::path sound = take::sound_file_of(take.file);
      std::error_code ignored;
      return {"/RecordStopConfirm",
              {desk.timecode_now(), take.file.filename().string(),
               std::filesystem::exists(sound, ignored) ? sound.filename().string() : ""}};
    });
  }
}

void OscRemote::ask(const std::string& what, const Answer& answer, std::function<OscMessage()> work) {
  if (door_->under_way >= kMostUnderWay) {
    door_->complain(fmt::format("{}: {} messages wait for the disk already", what, kMostUnderWay));
    return;
  }
  ++door_->under_way;
  desk_.recording.errands().ask([what, answer, work = std::move(work)] {
    try {
      answer.send(work());
    } catch (const std::exception& error) {
      answer.door->complain(fmt::format("{}: {}", what, error.what()));
    }
    --answer.door->under_way;
  });
}

void OscRemote::begin(const OscMessage& message, const Answer& answer) {
  const auto* slate = argument<std::string>(message, 0);
  const auto* number = argument<std::int32_t>(message, 1);
  slate_ = slate != nullptr ? as_utf8(*slate) : slate_;
  take_number_ = number != nullptr ? std::make_shared<std::int32_t>(*number) : take_number_;
  auto config = desk_.take_config();
  if (!config) {
    door_->complain("/RecordStart: facetd is still starting");
    return;
  }
  ask("/RecordStart", answer,
      [desk = desk_, slate = slate_, next = take_number_, take = *config]() mutable -> OscMessage {
        const std::string name = slate_take_name(slate, *next);
        take.more_meta = [entries = slate_entries(slate, *next)] { return entries; };
        take.file =
            take::take_path(desk.folder, name.empty() ? take::default_take_name(desk.folder, Clock::utc())
                                                      : take::free_take_name(desk.folder, name));
        desk.recording.begin(take);
        *next += *next < std::numeric_limits<std::int32_t>::max() ? 1 : 0;
        return {"/RecordStartConfirm", {desk.timecode_now()}};
      });
}

std::string as_utf8(std::string_view text) {
  std::string out;
  while (!text.empty()) {
    const std::size_t bytes = character_bytes(text);
    out += bytes > 0 ? text.substr(0, bytes) : "_";
    text.remove_prefix(std::max<std::size_t>(bytes, 1));
  }
  return out;
}

std::string slate_take_name(const std::string& slate, std::int32_t number) {
  std::string name = take::cut_text(as_utf8(slate), kMostSlateBytes);
  std::replace_if(
      name.begin(), name.end(),
      [](char character) {
        const auto code = static_cast<unsigned char>(character);
        return character == '/' || code < 0x20 || code == 0x7F;
      },
      '_');
  if (name.empty()) {
    return name;
  }
  if (name.front() == '.') {
    name.front() = '_';
  }
  return fmt::format("{}_{}", name, number);
}

}  // namespace facet::service
