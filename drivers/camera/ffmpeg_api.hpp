#pragma once

// Private to this room: the functions of FFmpeg that it uses, fetched from its libraries when a video is
// opened.

#include <fmt/format.h>

#include "facet/shared_library.hpp"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/display.h>
#include <libavutil/parseutils.h>
#include <libavutil/pixdesc.h>
#include <libswscale/swscale.h>
}

namespace facet::camera {

#define FACET_AVFORMAT_FUNCTIONS(X) \
  X(avformat_open_input)            \
  X(avformat_close_input)           \
  X(avformat_find_stream_info)      \
  X(avformat_seek_file)             \
  X(av_find_best_stream)            \
  X(av_guess_frame_rate)            \
  X(av_guess_sample_aspect_ratio)   \
  X(av_read_frame)                  \
  X(av_seek_frame)                  \
  X(av_stream_get_side_data)

#define FACET_AVCODEC_FUNCTIONS(X) \
  X(avcodec_alloc_context3)        \
  X(avcodec_flush_buffers)         \
  X(avcodec_free_context)          \
  X(avcodec_open2)                 \
  X(avcodec_parameters_to_context) \
  X(avcodec_receive_frame)         \
  X(avcodec_send_packet)           \
  X(av_packet_alloc)               \
  X(av_packet_free)                \
  X(av_packet_unref)

#define FACET_AVUTIL_FUNCTIONS(X) \
  X(av_dict_get)                  \
  X(av_display_rotation_get)      \
  X(av_frame_alloc)               \
  X(av_frame_free)                \
  X(av_log_set_level)             \
  X(av_parse_time)                \
  X(av_pix_fmt_desc_get)          \
  X(av_rescale)                   \
  X(av_rescale_q)                 \
  X(av_strerror)

#define FACET_SWSCALE_FUNCTIONS(X) \
  X(sws_freeContext)               \
  X(sws_getCachedContext)          \
  X(sws_getCoefficients)           \
  X(sws_scale)                     \
  X(sws_setColorspaceDetails)

/// The versions whose headers it was built with.
struct FfmpegApi {
#define FACET_MEMBER(name) decltype(&::name) name = nullptr;
  FACET_AVFORMAT_FUNCTIONS(FACET_MEMBER)
  FACET_AVCODEC_FUNCTIONS(FACET_MEMBER)
  FACET_AVUTIL_FUNCTIONS(FACET_MEMBER)
  FACET_SWSCALE_FUNCTIONS(FACET_MEMBER)
#undef FACET_MEMBER

  FfmpegApi() {
    const SharedLibrary avformat = opened("avformat", LIBAVFORMAT_VERSION_MAJOR);
    const SharedLibrary avcodec = opened("avcodec", LIBAVCODEC_VERSION_MAJOR);
    const SharedLibrary avutil = opened("avutil", LIBAVUTIL_VERSION_MAJOR);
    const SharedLibrary swscale = opened("swscale", LIBSWSCALE_VERSION_MAJOR);
#define FACET_FIND(name) avformat.find(name, #name);
    FACET_AVFORMAT_FUNCTIONS(FACET_FIND)
#undef FACET_FIND
#define FACET_FIND(name) avcodec.find(name, #name);
    FACET_AVCODEC_FUNCTIONS(FACET_FIND)
#undef FACET_FIND
#define FACET_FIND(name) avutil.find(name, #name);
    FACET_AVUTIL_FUNCTIONS(FACET_FIND)
#undef FACET_FIND
#define FACET_FIND(name) swscale.find(name, #name);
    FACET_SWSCALE_FUNCTIONS(FACET_FIND)
#undef FACET_FIND
    av_log_set_level(AV_LOG_QUIET);  // what goes wrong is said in our own words, with the file's name
  }

 private:
  static SharedLibrary opened(const char* name, int version) {
    return {fmt::format("lib{}.so.{}", name, version), fmt::format("lib{}{}", name, version)};
  }
};

/// Opened at the first call; throws Error(Unavailable) naming the library and its package, and tries again at
/// the next.
inline const FfmpegApi& ffmpeg() {
  static const FfmpegApi api;
  return api;
}

}  // namespace facet::camera
