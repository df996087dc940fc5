#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "avatar/bridge_target.hpp"
#include "avatar/face_state.hpp"
#include "avatar/osc.hpp"
#include "avatar/phone_messages.hpp"
#include "avatar/protocols.hpp"
#include "avatar/vrchat.hpp"
#include "facet/clock.hpp"

namespace facet::avatar {

/// The datagrams of a frame for every protocol that somebody listens to. One thread.
class BridgeMessages {
 public:
  struct Vmc {
    VmcShapes shapes;
    bool eye_bones;
  };
  /// device and subject: Live Link's (write_live_link_face). Until map() there are no further values.
  BridgeMessages(std::string device, std::string subject, Vmc vmc);

  /// Further values, by protocol, from the next begin() on.
  void map(const ValueMapping& mapping);

  /// A new frame: what was written of the one before is forgotten.
  /// neutral: whether a neutral pose was taken away
  void begin(const FaceState& state, bool neutral);
  /// The frame's datagrams for a protocol, written at the first call; none where it sends nothing of such a
  /// frame. Until the next begin(). version: of IFacialMocap alone.
  const std::vector<std::vector<std::byte>>& of(BridgeProtocol protocol,
                                                IFacialMocapVersion version = IFacialMocapVersion::V1);
  /// The same for one VRChat, whose writer knows its avatar. Until the next call.
  const std::vector<std::vector<std::byte>>& of(VrChatWriter& writer);

 private:
  float time_s() const;
  void write(BridgeProtocol protocol, IFacialMocapVersion version, std::vector<std::vector<std::byte>>& out);

  FaceState state_;  // first, as it is aligned to 16 bytes
  bool neutral_ = false;
  std::string device_;
  std::string subject_;
  Vmc vmc_;
  VmcContent vmc_content_;
  VrChatWriter vrchat_{MappedValues()};
  Clock::time_point started_ = Clock::now();

  struct Written {
    bool done = false;
    std::vector<std::vector<std::byte>> datagrams;
  };
  std::array<Written, kBridgeProtocols.size() + 1> written_;  ///< last: iFacialMocap's version 2
  OscBundles osc_{kMostDatagram};
};

}  // namespace facet::avatar
