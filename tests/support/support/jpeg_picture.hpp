#pragma once

#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

// After <cstdio>, which it needs and does not name.
#include <jpeglib.h>

namespace facet::test {

/// A JPEG picture, as a camera makes it (4:2:2 where it has colours); `progressive`: in several scans.
/// values   [height_px][width_px][1, 3 or 4]: grey, R G B or C M Y K
inline std::vector<std::uint8_t> jpeg_from(const std::vector<std::uint8_t>& values, int width_px,
                                           int height_px, bool progressive = false) {
  jpeg_compress_struct picture{};
  jpeg_error_mgr errors{};
  picture.err = jpeg_std_error(&errors);
  jpeg_create_compress(&picture);
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  jpeg_mem_dest(&picture, &bytes, &size);
  picture.image_width = static_cast<JDIMENSION>(width_px);
  picture.image_height = static_cast<JDIMENSION>(height_px);
  const std::size_t row_values = values.size() / static_cast<std::size_t>(height_px);
  picture.input_components = static_cast<int>(row_values) / width_px;
  picture.in_color_space = picture.input_components == 1   ? JCS_GRAYSCALE
                           : picture.input_components == 3 ? JCS_RGB
                                                           : JCS_CMYK;
  jpeg_set_defaults(&picture);
  jpeg_set_quality(&picture, 100, TRUE);
  picture.comp_info[0].v_samp_factor = 1;
  if (progressive) {
    jpeg_simple_progression(&picture);
  }
  jpeg_start_compress(&picture, TRUE);
  while (picture.next_scanline < picture.image_height) {
    // The library reads alone through this pointer.
    auto* pixels = const_cast<JSAMPROW>(&values[picture.next_scanline * row_values]);
    jpeg_write_scanlines(&picture, &pixels, 1);
  }
  jpeg_finish_compress(&picture);
  std::vector<std::uint8_t> jpeg(bytes, bytes + size);
  std::free(bytes);
  jpeg_destroy_compress(&picture);
  return jpeg;
}

/// The same of one colour.
inline std::vector<std::uint8_t> jpeg_of(std::array<std::uint8_t, 3> rgb, int width_px, int height_px,
                                         bool progressive = false) {
  std::vector<std::uint8_t> values;
  for (int pixel = 0; pixel < width_px * height_px; ++pixel) {
    values.insert(values.end(), rgb.begin(), rgb.end());
  }
  return jpeg_from(values, width_px, height_px, progressive);
}

/// The same without its Huffman tables, as many Motion JPEG cameras leave them out.
inline std::vector<std::uint8_t> without_huffman_tables(const std::vector<std::uint8_t>& jpeg) {
  std::vector<std::uint8_t> kept(jpeg.begin(), jpeg.begin() + 2);
  std::size_t at = 2;
  while (jpeg[at + 1] != 0xDA) {  // until the scan begins
    const std::size_t length = 2 + static_cast<std::size_t>(jpeg[at + 2] << 8 | jpeg[at + 3]);
    if (jpeg[at + 1] != 0xC4) {
      kept.insert(kept.end(), jpeg.begin() + static_cast<std::ptrdiff_t>(at),
                  jpeg.begin() + static_cast<std::ptrdiff_t>(at + length));
    }
    at += length;
  }
  kept.insert(kept.end(), jpeg.begin() + static_cast<std::ptrdiff_t>(at), jpeg.end());
  return kept;
}

}  // namespace facet::test
