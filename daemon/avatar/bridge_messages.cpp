#include "avatar/bridge_messages.hpp"

#include <chrono>
#include <utility>

namespace facet::avatar {
namespace {

double time_of_day_s() {
  const auto now = Clock::utc();
  return std::chrono::duration<double>(now - std::chrono::floor<std::chrono::days>(now)).count();
}

std::int64_t unix_ms() {
  return std::chrono::duration_cast<std::chrono::milliseconds>(Clock::utc().time_since_epoch()).count();
}

}  // namespace

BridgeMessages::BridgeMessages(std::string device, std::string subject, Vmc vmc)
    : device_(std::move(device)),
      subject_(std::move(subject)),
      vmc_(vmc),
      vmc_content_(vmc_content(vmc.shapes, vmc.eye_bones, {})) {}

void BridgeMessages::map(const ValueMapping& mapping) {
  vmc_content_ = vmc_content(vmc_.shapes, vmc_.eye_bones, mapping.vmc);
  vrchat_ = VrChatWriter(mapping.vrchat);
}

void BridgeMessages::begin(const FaceState& state, bool neutral) {
  state_ = state;
  neutral_ = neutral;
  for (Written& written : written_) {
    written.done = false;
  }
}

const std::vector<std::vector<std::byte>>& BridgeMessages::of(BridgeProtocol protocol,
                                                              IFacialMocapVersion version) {
  const bool second = protocol == BridgeProtocol::IFacialMocap && version == IFacialMocapVersion::V2;
  Written& written = second ? written_.back() : written_.at(static_cast<std::size_t>(protocol));
  if (!written.done) {
    written.datagrams.clear();
    write(protocol, version, written.datagrams);
    written.done = true;
  }
  return written.datagrams;
}

const std::vector<std::vector<std::byte>>& BridgeMessages::of(VrChatWriter& writer) {
  osc_.clear();
  writer.write(state_, time_s(), osc_);
  return osc_.bundles();
}

float BridgeMessages::time_s() const {
  return std::chrono::duration<float>(Clock::now() - started_).count();
}

void BridgeMessages::write(BridgeProtocol protocol, IFacialMocapVersion version,
                           std::vector<std::vector<std::byte>>& out) {
  const bool has_values = state_.tracked && state_.has_expression;
  osc_.clear();
  switch (protocol) {
    case BridgeProtocol::Vmc:
      write_vmc(state_, time_s(), neutral_, vmc_content_, osc_);
      out = osc_.bundles();
      break;
    case BridgeProtocol::VrChat:
      vrchat_.write(state_, time_s(), osc_);
      out = osc_.bundles();
      break;
    case BridgeProtocol::LiveLinkFace:
      if (has_values) {
        write_live_link_face(state_, device_, subject_, time_of_day_s(), out.emplace_back());
      }
      break;
    case BridgeProtocol::IFacialMocap:
      if (has_values) {
        write_ifacialmocap(state_, version, out.emplace_back());
      }
      break;
    case BridgeProtocol::VTubeStudio:
      write_vtube_studio(state_, unix_ms(), out.emplace_back());
      break;
    case BridgeProtocol::VTubeStudioPlugin:
      break;  // no datagrams: VtsLink
  }
}

}  // namespace facet::avatar
