#include "avatar/vrchat_finder.hpp"

#include <arpa/inet.h>
#include <arpa/nameser.h>
#include <fmt/format.h>
#include <net/if.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <optional>
#include <thread>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "stream/http_get.hpp"
#include "stream/unix_socket.hpp"
#include "stream/web_socket_client.hpp"

namespace facet::avatar {
namespace {

/// That are asked, whether they answer or not.
constexpr std::size_t kMostClients = 8;
constexpr std::size_t kMostNetworks = 32;
constexpr int kMostFailures = 2;
/// Of the list, once the avatar has changed: the first may come while the avatar is still loaded.
constexpr int kReads = 2;
/// Rounds after which it is read again though nobody told of a change: an avatar may be uploaded anew.
constexpr int kRoundsToReadAgain = 6;
/// At a time, so that others have their turn.
constexpr int kMostDatagrams = 64;
/// Even where there is no descriptor left to be woken by.
constexpr std::int64_t kMostWait_ms = 500;

in_addr v4_of(const SocketAddress& address) {
  return reinterpret_cast<const sockaddr_in&>(address.storage).sin_addr;
}

SocketAddress with_port(const SocketAddress& address, std::uint16_t port) {
  SocketAddress out = address;
  reinterpret_cast<sockaddr_in&>(out.storage).sin_port = htons(port);
  return out;
}

BridgeTarget target_of(const SocketAddress& address) {
  std::array<char, INET_ADDRSTRLEN> text{};
  const auto& v4 = reinterpret_cast<const sockaddr_in&>(address.storage);
  ::inet_ntop(AF_INET, &v4.sin_addr, text.data(), text.size());
  return {BridgeProtocol::VrChat, text.data(), ntohs(v4.sin_port)};
}

/// Those that are up, of IPv4. By ioctl, as a service's unit may refuse getifaddrs' netlink socket.
std::vector<OwnNetwork> networks(int socket) {
  std::array<ifreq, kMostNetworks> entries{};
  ifconf list{};
  list.ifc_len = static_cast<int>(entries.size() * sizeof(ifreq));
  list.ifc_req = entries.data();
  std::vector<OwnNetwork> out;
  if (::ioctl(socket, SIOCGIFCONF, &list) < 0) {
    return out;
  }
  const std::size_t count = static_cast<std::size_t>(list.ifc_len) / sizeof(ifreq);
  for (std::size_t i = 0; i < std::min(count, entries.size()); ++i) {
    ifreq flags = entries.at(i);
    ifreq mask = entries.at(i);
    if (entries.at(i).ifr_addr.sa_family != AF_INET || ::ioctl(socket, SIOCGIFFLAGS, &flags) < 0 ||
        (flags.ifr_flags & IFF_UP) == 0 || ::ioctl(socket, SIOCGIFNETMASK, &mask) < 0) {
      continue;
    }
    OwnNetwork network;
    std::memcpy(&network.address.storage, &entries.at(i).ifr_addr, sizeof(sockaddr_in));
    network.address.length = sizeof(sockaddr_in);
    network.mask = reinterpret_cast<const sockaddr_in&>(mask.ifr_netmask).sin_addr.s_addr;
    out.push_back(network);
  }
  return out;
}

bool is_loopback(const SocketAddress& address) {
  constexpr std::uint32_t kLoopbackNet = 127;
  return ntohl(v4_of(address).s_addr) >> 24U == kLoopbackNet;
}

}  // namespace

Nearness nearness(const SocketAddress& address, std::span<const OwnNetwork> networks) {
  if (address.length == 0 || address.storage.ss_family != AF_INET) {
    return Nearness::Far;
  }
  bool near = false;
  for (const OwnNetwork& network : networks) {
    if (same_host(network.address, address)) {
      return Nearness::Own;
    }
    near = near || (network.mask != 0 &&
                    ((v4_of(network.address).s_addr ^ v4_of(address).s_addr) & network.mask) == 0);
  }
  return is_loopback(address) ? Nearness::Own : near ? Nearness::Near : Nearness::Far;
}

BridgeTarget FoundVrChat::target() const {
  return target_of(addresses.front());
}

struct VrChatFinder::Impl {
  explicit Impl(const VrChatFinderConfig& given) : config(given) {}

  /// Somebody who says that a VRChat is there.
  struct Client {
    enum class Step { HostInfo, Change, Avatar };

    VrChatService service;
    SocketAddress machine;              ///< that answered
    std::vector<SocketAddress> places;  ///< of its HTTP, to be tried in turn
    std::size_t place = 0;
    std::size_t tried = 0;  ///< in this round
    Clock::time_point next = Clock::now();
    Step step = Step::HostInfo;
    std::unique_ptr<stream::HttpGet> get{};
    Clock::time_point deadline{};
    int failures = 0;
    std::vector<SocketAddress> addresses{};  ///< FoundVrChat's; none before it has told
    std::shared_ptr<const AvatarParameters> avatar{};
    int reads_left = kReads;  ///< of the list
    int rounds = 0;           ///< since it was read
    int list_failures = 0;
  };

  VrChatFinderConfig config;
  stream::FileDescriptor wake{::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)};
  std::atomic<bool> stopping = false;

  mutable Mutex mutex;
  std::vector<FoundVrChat> found FACET_GUARDED_BY(mutex);
  std::string fault FACET_GUARDED_BY(mutex);
  std::atomic<std::uint64_t> changes = 0;

  // The thread's own.
  stream::FileDescriptor questions;
  std::vector<OwnNetwork> own;
  std::size_t places_asked = 0;  ///< names whose place was asked for since the last question to all
  std::vector<Client> clients;
  Clock::time_point next_question = Clock::now();
  std::jthread thread;

  void run();
  void work();
  void wait(Clock::time_point until) const;
  void ask_all();
  int ask(const std::string& name, int type) const;
  void hear();
  void take(const VrChatService& service, const SocketAddress& from);
  bool is_own(const SocketAddress& address) const;
  void begin(Client& client);
  bool go_on(Client& client);
  void take_answer(Client& client);
  void end_round(Client& client, bool failed);
  void publish();
};

void VrChatFinder::Impl::run() {
  ::pthread_setname_np(::pthread_self(), "facet-vrchat");
  while (!stopping) {
    try {
      work();
    } catch (const std::exception& error) {
      // No memory for an answer: it is asked for again.
      {
        const Lock lock(mutex);
        fault = error.what();
      }
      stream::wait_for_event(wake.get(), std::chrono::milliseconds(100));
    }
  }
}

void VrChatFinder::Impl::work() {
  const auto now = Clock::now();
  if (now >= next_question) {
    next_question = now + config.every;
    ask_all();
  }
  hear();
  auto until = next_question;
  for (Client& client : clients) {
    if (client.get == nullptr && now >= client.next) {
      begin(client);
    }
    while (client.get != nullptr && go_on(client)) {
    }
    until = std::min(until, client.get != nullptr ? client.deadline : client.next);
  }
  std::erase_if(clients, [](const Client& client) { return client.failures >= kMostFailures; });
  publish();
  wait(until);
}

void VrChatFinder::Impl::wait(Clock::time_point until) const {
  std::vector<pollfd> waited{{wake.get(), POLLIN, 0}, {questions.get(), POLLIN, 0}};
  for (const Client& client : clients) {
    if (client.get != nullptr) {
      waited.push_back({client.get->socket(), client.get->events(), 0});
    }
  }
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(until - Clock::now()).count();
  ::poll(waited.data(), waited.size(), static_cast<int>(std::clamp<std::int64_t>(left, 0, kMostWait_ms)));
}

void VrChatFinder::Impl::ask_all() {
  std::string now;
  if (!questions) {
    questions.reset(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  }
  own = networks(questions.get());
  places_asked = 0;
  const int failed = questions ? ask(kOscQueryService, ns_t_ptr) : errno;
  if (failed != 0) {
    now = fmt::format("VRChat can't be looked for: {}", std::strerror(failed));
  }
  const Lock lock(mutex);
  fault = now;
}

/// On all networks. Returns 0, or errno where it went out to none of them.
int VrChatFinder::Impl::ask(const std::string& name, int type) const {
  const std::vector<std::uint8_t> question = mdns_question(name, type);
  int failed = ENETDOWN;
  for (const OwnNetwork& network : own) {
    const in_addr over = v4_of(network.address);
    const bool sent =
        ::setsockopt(questions.get(), IPPROTO_IP, IP_MULTICAST_IF, &over, sizeof(over)) == 0 &&
        ::sendto(questions.get(), question.data(), question.size(), MSG_NOSIGNAL,
                 reinterpret_cast<const sockaddr*>(&config.asked.storage), config.asked.length) >= 0;
    failed = sent ? 0 : failed != 0 ? errno : 0;
  }
  return failed;
}

void VrChatFinder::Impl::hear() {
  std::array<std::uint8_t, 9000> datagram{};  // RFC 6762, section 17
  for (int left = kMostDatagrams; questions && left > 0; --left) {
    SocketAddress from;
    from.length = sizeof(from.storage);
    const auto size = ::recvfrom(questions.get(), datagram.data(), datagram.size(), 0,
                                 reinterpret_cast<sockaddr*>(&from.storage), &from.length);
    if (size < 0) {
      return;
    }
    const Nearness near = nearness(from, own);
    if (near == Nearness::Own || (near == Nearness::Near && config.where == VrChatFind::Network)) {
      for (const VrChatService& service :
           parse_mdns_answer({datagram.data(), static_cast<std::size_t>(size)})) {
        take(service, from);
      }
    }
  }
}

void VrChatFinder::Impl::take(const VrChatService& service, const SocketAddress& from) {
  const auto known = std::find_if(clients.begin(), clients.end(),
                                  [&](const Client& client) { return client.service.name == service.name; });
  const bool is_new = known == clients.end();
  if (service.port == 0) {
    // One datagram of names alone must not become many questions.
    if (is_new && clients.size() < kMostClients && places_asked < kMostClients) {
      ++places_asked;
      ask(service.full_name(), ns_t_srv);
    }
    return;
  }
  if (is_new ? clients.size() >= kMostClients
             : known->service.port == service.port || is_own(known->machine) != is_own(from) ||
                   (!is_own(from) && !same_host(known->machine, from))) {
    return;  // nothing new, or one of another machine that has this one's name
  }
  Client client;
  client.service = service;
  client.machine = from;
  if (is_own(from)) {
    client.places.push_back(socket_address("127.0.0.1", service.port));
  }
  if (!is_loopback(from)) {
    client.places.push_back(with_port(from, service.port));
  }
  if (is_new) {
    clients.push_back(std::move(client));
  } else {
    *known = std::move(client);
  }
}

bool VrChatFinder::Impl::is_own(const SocketAddress& address) const {
  return nearness(address, own) == Nearness::Own;
}

/// The next question of a round, or the same one at another place.
void VrChatFinder::Impl::begin(Client& client) {
  const SocketAddress& place = client.places[client.place];
  stream::FileDescriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket || !keep_in_network(socket.get(), AF_INET)) {
    end_round(client, true);
    return;
  }
  const char* const path = client.step == Client::Step::HostInfo ? "/?HOST_INFO"
                           : client.step == Client::Step::Change ? "/avatar/change"
                                                                 : "/avatar";
  client.get =
      std::make_unique<stream::HttpGet>(std::move(socket), target_of(place).text(), path, kMostOscQueryBytes);
  client.get->connect(reinterpret_cast<const sockaddr*>(&place.storage), place.length);
  client.deadline = Clock::now() + config.patience;
}

/// Whether there may be more to do at once.
bool VrChatFinder::Impl::go_on(Client& client) {
  if (client.get->work()) {
    if (Clock::now() < client.deadline) {
      return false;
    }
  } else if (client.get->fault().empty()) {
    try {
      take_answer(client);
      return true;
    } catch (const Error&) {
      // What it says is of no use: another place may know better.
    }
  }
  client.get.reset();
  if (client.step == Client::Step::Change) {
    client.step = Client::Step::Avatar;  // one that does not tell of changes is asked for all
    begin(client);
    return true;
  }
  if (client.step == Client::Step::Avatar) {
    // Where it is, is known. What its avatar has stays what it was, for a while.
    if (++client.list_failures >= kMostFailures) {
      client.avatar.reset();
    }
    end_round(client, false);
    return false;
  }
  client.place = (client.place + 1) % client.places.size();
  if (++client.tried < client.places.size()) {
    begin(client);
    return true;
  }
  end_round(client, true);
  return false;
}

void VrChatFinder::Impl::take_answer(Client& client) {
  const std::string& text = client.get->body();
  switch (client.step) {
    case Client::Step::HostInfo: {
      const OscHostInfo info = parse_host_info(text);
      const SocketAddress told = socket_address(info.address, info.port);
      const SocketAddress place = with_port(client.places[client.place], info.port);
      const bool here = is_own(place);
      // Of its address only where on this machine it listens: nobody is sent on to another.
      const bool chooses = here && told.storage.ss_family == AF_INET && is_own(told);
      client.addresses = {chooses ? told : place};
      for (const OwnNetwork& network : own) {
        if (here) {
          client.addresses.push_back(with_port(network.address, info.port));
        }
      }
      client.step = Client::Step::Change;
      break;
    }
    case Client::Step::Change: {
      const std::string avatar = parse_avatar_change(text);
      if (client.avatar == nullptr || client.avatar->avatar != avatar) {
        client.reads_left = kReads;
      } else if (avatar.empty() || ++client.rounds >= kRoundsToReadAgain) {
        client.reads_left = std::max(client.reads_left, 1);  // what does not say who it is may be another
      }
      if (client.reads_left == 0) {
        end_round(client, false);
        return;
      }
      client.step = Client::Step::Avatar;
      break;
    }
    case Client::Step::Avatar: {
      AvatarParameters avatar = parse_avatar(text);
      client.rounds = 0;
      if (client.avatar == nullptr || !(*client.avatar == avatar)) {
        // While an avatar is loaded there is none.
        client.avatar =
            avatar.list.empty() ? nullptr : std::make_shared<const AvatarParameters>(std::move(avatar));
      }
      client.reads_left -= client.avatar != nullptr ? 1 : 0;
      client.list_failures = 0;
      end_round(client, false);
      return;
    }
  }
  begin(client);
}

void VrChatFinder::Impl::end_round(Client& client, bool failed) {
  client.get.reset();
  client.step = Client::Step::HostInfo;
  client.tried = 0;
  client.failures = failed ? client.failures + 1 : 0;
  client.next = Clock::now() + config.every;
}

void VrChatFinder::Impl::publish() {
  std::vector<FoundVrChat> now;
  for (const Client& client : clients) {
    if (!client.addresses.empty() && now.size() < kMostFoundVrChats) {
      now.push_back({client.service.name, client.addresses, client.avatar});
    }
  }
  const auto same = [](const FoundVrChat& one, const FoundVrChat& other) {
    return one.name == other.name && one.avatar == other.avatar &&
           std::equal(one.addresses.begin(), one.addresses.end(), other.addresses.begin(),
                      other.addresses.end(), same_address);
  };
  const Lock lock(mutex);
  if (!std::equal(now.begin(), now.end(), found.begin(), found.end(), same)) {
    found = std::move(now);
    ++changes;
  }
}

VrChatFinder::VrChatFinder(const VrChatFinderConfig& config) : impl_(std::make_unique<Impl>(config)) {}

VrChatFinder::~VrChatFinder() {
  request_stop();
  stop();
}

void VrChatFinder::start() {
  impl_->thread = std::jthread([this] { impl_->run(); });
}

void VrChatFinder::request_stop() {
  impl_->stopping = true;
  stream::signal_event(impl_->wake.get());
}

void VrChatFinder::stop() {
  if (impl_->thread.joinable()) {
    impl_->thread.join();
  }
}

std::vector<FoundVrChat> VrChatFinder::found() const {
  const Lock lock(impl_->mutex);
  return impl_->found;
}

std::uint64_t VrChatFinder::changes() const {
  return impl_->changes;
}

std::string VrChatFinder::fault() const {
  const Lock lock(impl_->mutex);
  return impl_->fault;
}

}  // namespace facet::avatar
