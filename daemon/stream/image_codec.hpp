#pragma once

#include <cstddef>
#include <memory>

#include "facet/frame_set.hpp"
#include "facet_generated.h"
#include "stream/protocol.hpp"

/// The pictures of a frame, as part of its message. For Encoder and decode_frame alone.
namespace facet::stream {

/// Bytes of the pixels as they would be written, at most.
std::size_t pixel_bytes(const FrameSet& set, const WantedPixels& wanted);

flatbuffers::Offset<wire::FrameSet> write_frame_set(flatbuffers::FlatBufferBuilder& builder,
                                                    const FrameSet& set, const WantedPixels& wanted);

/// media_time_ns: of the frame that has it. Throws Error(UnreadableInput) with the field that is wrong. A
/// picture without pixels has a size and no pixels (Frame::empty).
std::shared_ptr<const FrameSet> read_frame_set(const wire::FrameSet& set, std::int64_t media_time_ns);

}  // namespace facet::stream
