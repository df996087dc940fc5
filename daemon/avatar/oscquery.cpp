#include "avatar/oscquery.hpp"

#include <arpa/nameser.h>
#include <fmt/format.h>
#include <resolv.h>
#include <strings.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <nlohmann/json.hpp>
#include <optional>

#include "facet/error.hpp"
#include "files/json_text.hpp"

namespace facet::avatar {
namespace {

using nlohmann::json;

/// A hundred bytes a value (files::JsonLimits) are 6 MB.
constexpr files::JsonLimits kLimits{kMostOscQueryBytes, 1U << 16U, 64};
constexpr std::size_t kMostNameBytes = 255;
constexpr std::size_t kMostAvatarBytes = 64;

/// The first label of an instance's name, where that is one of a VRChat.
std::optional<std::string> vrchat_of(std::string_view full_name) {
  const std::size_t dot = full_name.find('.');
  if (dot == std::string_view::npos || dot > NS_MAXLABEL || !full_name.starts_with(kVrChatName) ||
      ::strcasecmp(std::string(full_name.substr(dot + 1)).c_str(), kOscQueryService) != 0) {
    return std::nullopt;
  }
  const std::string_view name = full_name.substr(0, dot);
  const bool plain =
      std::all_of(name.begin(), name.end(), [](unsigned char c) { return std::isalnum(c) != 0 || c == '-'; });
  return plain ? std::optional<std::string>(name) : std::nullopt;
}

/// The entry of a name, made where there is none and there is place.
VrChatService* entry_of(std::vector<VrChatService>& services, const std::string& name) {
  const auto found = std::find_if(services.begin(), services.end(),
                                  [&](const VrChatService& each) { return each.name == name; });
  if (found != services.end()) {
    return &*found;
  }
  return services.size() < kMostServices ? &services.emplace_back(VrChatService{name, 0}) : nullptr;
}

/// What a record says of a VRChat.
void take_record(const ns_msg& message, const ns_rr& record, std::vector<VrChatService>& services) {
  constexpr std::size_t kPortAt = 4;  // behind priority and weight (RFC 2782)
  const std::uint8_t* const data = ns_rr_rdata(record);
  std::array<char, NS_MAXDNAME> text{};
  if (ns_rr_type(record) == ns_t_ptr) {
    const bool ours = ::strcasecmp(ns_rr_name(record), kOscQueryService) == 0 &&
                      ::dn_expand(ns_msg_base(message), ns_msg_end(message), data, text.data(),
                                  static_cast<int>(text.size())) == ns_rr_rdlen(record);
    if (const auto name = ours ? vrchat_of(text.data()) : std::nullopt) {
      entry_of(services, *name);
    }
  } else if (ns_rr_type(record) == ns_t_srv && ns_rr_rdlen(record) > kPortAt + 2) {
    const auto name = vrchat_of(ns_rr_name(record));
    VrChatService* const service = name ? entry_of(services, *name) : nullptr;
    if (service != nullptr) {
      service->port = static_cast<std::uint16_t>(data[kPortAt] << 8U | data[kPortAt + 1]);
    }
  }
}

/// A text of an object; empty where there is none.
std::string text_of(const json& node, const char* key) {
  const auto found = node.find(key);
  return found != node.end() && found->is_string() ? found->get<std::string>() : "";
}

bool sound_name(std::string_view name, std::size_t most) {
  return !name.empty() && name.size() <= most &&
         std::none_of(name.begin(), name.end(), [](unsigned char c) { return c < 0x20 || c == 0x7F; });
}

/// VALUE of a node of one text, [TEXT].
std::string value_of(const json& node) {
  const auto value = node.find("VALUE");
  if (value == node.end() || !value->is_array() || value->empty() || !value->front().is_string()) {
    return "";
  }
  const std::string text = value->front();
  return sound_name(text, kMostAvatarBytes) ? text : "";
}

/// Recurses as deep as kLimits let a text nest.
void collect(const json& node, std::vector<AvatarParameter>& list) {
  constexpr std::string_view kRoot = "/avatar/parameters/";
  constexpr unsigned kMayBeSet = 2;
  if (!node.is_object()) {
    return;
  }
  const std::string path = text_of(node, "FULL_PATH");
  const std::string type = text_of(node, "TYPE");
  const auto access = node.find("ACCESS");
  const bool settable = access == node.end() || !access->is_number_unsigned() ||
                        (access->get<std::uint64_t>() & kMayBeSet) != 0;
  if (type.size() == 1 && settable && path.starts_with(kRoot) && list.size() < kMostAvatarParameters &&
      sound_name(std::string_view(path).substr(kRoot.size()), kMostNameBytes)) {
    list.push_back({path.substr(kRoot.size()), type == "F" ? 'T' : type.front()});
  }
  if (const auto contents = node.find("CONTENTS"); contents != node.end() && contents->is_object()) {
    for (const json& child : *contents) {
      collect(child, list);
    }
  }
}

json parse(std::string_view text, const char* what) {
  json node = files::parse_json(text, kLimits, what);
  if (!node.is_object()) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: is no object", what));
  }
  return node;
}

}  // namespace

std::vector<std::uint8_t> mdns_question(const std::string& name, int type) {
  std::vector<std::uint8_t> message(NS_PACKETSZ);
  const int bytes = ::dn_comp(name.c_str(), message.data() + NS_HFIXEDSZ,
                              NS_PACKETSZ - NS_HFIXEDSZ - NS_QFIXEDSZ, nullptr, nullptr);
  if (bytes < 0) {
    throw Error(ErrorKind::Internal, fmt::format("'{}' is no name of DNS", name));
  }
  message[5] = 1;  // of questions; identifier, flags and all other counts are 0 (RFC 6762, section 18)
  std::uint8_t* const behind = message.data() + NS_HFIXEDSZ + bytes;
  ns_put16(static_cast<unsigned>(type), behind);
  ns_put16(ns_c_in, behind + 2);
  message.resize(static_cast<std::size_t>(NS_HFIXEDSZ + bytes + NS_QFIXEDSZ));
  return message;
}

std::vector<VrChatService> parse_mdns_answer(std::span<const std::uint8_t> datagram) {
  std::vector<VrChatService> services;
  ns_msg message{};
  if (datagram.size() > NS_MAXMSG ||
      ::ns_initparse(datagram.data(), static_cast<int>(datagram.size()), &message) < 0 ||
      ns_msg_getflag(message, ns_f_qr) == 0 || ns_msg_getflag(message, ns_f_opcode) != ns_o_query ||
      ns_msg_getflag(message, ns_f_rcode) != ns_r_noerror) {
    return services;
  }
  for (const ns_sect section : {ns_s_an, ns_s_ar}) {
    for (int i = 0; i < ns_msg_count(message, section); ++i) {
      ns_rr record{};
      if (::ns_parserr(&message, section, i, &record) < 0) {
        break;
      }
      take_record(message, record, services);
    }
  }
  return services;
}

OscHostInfo parse_host_info(std::string_view text) {
  const json node = parse(text, "HOST_INFO");
  const std::string transport = text_of(node, "OSC_TRANSPORT");
  const auto port = node.find("OSC_PORT");
  const bool number = port != node.end() && port->is_number_unsigned();
  const std::uint64_t value = number ? port->get<std::uint64_t>() : 0;
  if (value < 1 || value > 65535 || (!transport.empty() && transport != "UDP")) {
    throw Error(ErrorKind::UnreadableInput, "HOST_INFO: has no port of UDP");
  }
  return {text_of(node, "OSC_IP"), static_cast<std::uint16_t>(value)};
}

std::string parse_avatar_change(std::string_view text) {
  return value_of(parse(text, "/avatar/change"));
}

AvatarParameters parse_avatar(std::string_view text) {
  const json node = parse(text, "/avatar");
  AvatarParameters avatar;
  if (const auto contents = node.find("CONTENTS"); contents != node.end() && contents->is_object()) {
    if (const auto change = contents->find("change"); change != contents->end() && change->is_object()) {
      avatar.avatar = value_of(*change);
    }
  }
  collect(node, avatar.list);
  return avatar;
}

}  // namespace facet::avatar
