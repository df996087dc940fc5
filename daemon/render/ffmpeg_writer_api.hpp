#pragma once

// Private to this room: the functions of FFmpeg that it writes videos with, fetched from its libraries when
// one is begun.

#include <fmt/format.h>

#include "facet/shared_library.hpp"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/channel_layout.h>
#include <libavutil/dict.h>
#include <libavutil/error.h>
#include <libavutil/frame.h>
#include <libavutil/log.h>
#include <libavutil/opt.h>
}

namespace facet::render {

#define FACET_AVFORMAT_FUNCTIONS(X) \
  X(avformat_alloc_output_context2) \
  X(avformat_free_context)          \
  X(avformat_new_stream)            \
  X(avformat_write_header)          \
  X(av_interleaved_write_frame)     \
  X(av_write_trailer)               \
  X(avio_alloc_context)             \
  X(avio_context_free)

#define FACET_AVCODEC_FUNCTIONS(X)   \
  X(avcodec_alloc_context3)          \
  X(avcodec_find_encoder)            \
  X(avcodec_find_encoder_by_name)    \
  X(avcodec_free_context)            \
  X(avcodec_open2)                   \
  X(avcodec_parameters_from_context) \
  X(avcodec_receive_packet)          \
  X(avcodec_send_frame)              \
  X(av_packet_alloc)                 \
  X(av_packet_free)                  \
  X(av_packet_rescale_ts)

#define FACET_AVUTIL_FUNCTIONS(X) \
  X(av_frame_alloc)               \
  X(av_frame_free)                \
  X(av_frame_get_buffer)          \
  X(av_frame_make_writable)       \
  X(av_free)                      \
  X(av_freep)                     \
  X(av_malloc)                    \
  X(av_opt_set)                   \
  X(av_channel_layout_default)    \
  X(av_dict_set)                  \
  X(av_strerror)

/// The versions whose headers it was built with.
struct FfmpegWriterApi {
#define FACET_MEMBER(name) decltype(&::name) name = nullptr;
  FACET_AVFORMAT_FUNCTIONS(FACET_MEMBER)
  FACET_AVCODEC_FUNCTIONS(FACET_MEMBER)
  FACET_AVUTIL_FUNCTIONS(FACET_MEMBER)
#undef FACET_MEMBER

  FfmpegWriterApi() {
    const SharedLibrary avformat = opened("avformat", LIBAVFORMAT_VERSION_MAJOR);
    const SharedLibrary avcodec = opened("avcodec", LIBAVCODEC_VERSION_MAJOR);
    const SharedLibrary avutil = opened("avutil", LIBAVUTIL_VERSION_MAJOR);
#define FACET_FIND(name) avformat.find(name, #name);
    FACET_AVFORMAT_FUNCTIONS(FACET_FIND)
#undef FACET_FIND
#define FACET_FIND(name) avcodec.find(name, #name);
    FACET_AVCODEC_FUNCTIONS(FACET_FIND)
#undef FACET_FIND
#define FACET_FIND(name) avutil.find(name, #name);
    FACET_AVUTIL_FUNCTIONS(FACET_FIND)
#undef FACET_FIND
  }

 private:
  static SharedLibrary opened(const char* name, int version) {
    return {fmt::format("lib{}.so.{}", name, version), fmt::format("lib{}{}", name, version)};
  }
};

/// Opened at the first call; throws Error(Unavailable) naming the library and its package, and tries again at
/// the next.
inline const FfmpegWriterApi& ffmpeg() {
  static const FfmpegWriterApi api;
  return api;
}

}  // namespace facet::render
