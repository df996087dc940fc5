#include "camera/jpeg_decoder.hpp"

#include <csetjmp>
#include <cstdio>

// After <cstdio>, which it needs and does not name.
#include <jpeglib.h>

#include "facet/error.hpp"

namespace facet::camera {

/// The library leaves its functions with a jump where they cannot go on: no object that must be destroyed may
/// live between setjmp and its calls.
struct JpegDecoder::State {
  jpeg_error_mgr errors{};  // first: the library knows the state by its address
  jpeg_decompress_struct picture{};
  std::jmp_buf escape{};

  static void jump(j_common_ptr common) { std::longjmp(reinterpret_cast<State*>(common->err)->escape, 1); }
  static void count_warning(j_common_ptr common, int level) {
    common->err->num_warnings += level < 0 ? 1 : 0;
  }
  static void say_nothing(j_common_ptr) {}

  bool create() {
    picture.err = jpeg_std_error(&errors);
    errors.error_exit = jump;
    errors.emit_message = count_warning;
    errors.output_message = say_nothing;
    if (setjmp(escape) != 0) {
      return false;
    }
    jpeg_create_decompress(&picture);
    return true;
  }

  JpegOutcome decode(std::span<const std::uint8_t> bytes, int width_px, int height_px, std::uint8_t* rgba,
                     std::size_t stride_bytes) {
    if (setjmp(escape) != 0) {
      jpeg_abort_decompress(&picture);
      return JpegOutcome::Unreadable;
    }
    jpeg_mem_src(&picture, bytes.data(), bytes.size());
    jpeg_read_header(&picture, TRUE);
    // Cameras send one scan; thousands of them, in a few bytes, would take seconds.
    if (static_cast<int>(picture.image_width) != width_px ||
        static_cast<int>(picture.image_height) != height_px || jpeg_has_multiple_scans(&picture) != 0) {
      jpeg_abort_decompress(&picture);
      return JpegOutcome::Unreadable;
    }
    picture.out_color_space = JCS_EXT_RGBA;
    jpeg_start_decompress(&picture);
    while (picture.output_scanline < picture.output_height) {
      JSAMPROW row = rgba + picture.output_scanline * stride_bytes;
      jpeg_read_scanlines(&picture, &row, 1);
    }
    jpeg_abort_decompress(&picture);  // what follows the picture does not matter
    return errors.num_warnings == 0 ? JpegOutcome::Whole : JpegOutcome::Damaged;
  }
};

void JpegDecoder::Destroy::operator()(State* state) const {
  jpeg_destroy_decompress(&state->picture);
  delete state;
}

JpegDecoder::JpegDecoder() : state_(new State) {
  if (!state_->create()) {
    throw Error(ErrorKind::Internal, "libjpeg-turbo does not start: out of memory, or of another version");
  }
}

JpegOutcome JpegDecoder::decode(std::span<const std::uint8_t> bytes, int width_px, int height_px,
                                std::uint8_t* rgba, std::size_t stride_bytes) {
  return state_->decode(bytes, width_px, height_px, rgba, stride_bytes);
}

}  // namespace facet::camera
