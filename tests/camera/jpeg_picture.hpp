#pragma once

#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

// After <cstdio>, which it needs and does not name.
#include <jpeglib.h>

namespace facet::test {

/// A JPEG picture of one colour, as a camera makes it (4:2:2); `progressive`: in several scans.
inline std::vector<std::uint8_t> jpeg_of(std::array<std::uint8_t, 3> rgb, int width_px, int height_px,
                                         bool progressive = false) {
  jpeg_compress_struct picture{};
  jpeg_error_mgr errors{};
  picture.err = jpeg_std_error(&errors);
  jpeg_create_compress(&picture);
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  jpeg_mem_dest(&picture, &bytes, &size);
  picture.image_width = static_cast<JDIMENSION>(width_px);
  picture.image_height = static_cast<JDIMENSION>(height_px);
  picture.input_components = 3;
  picture.in_color_space = JCS_RGB;
  jpeg_set_defaults(&picture);
  jpeg_set_quality(&picture, 100, TRUE);
  picture.comp_info[0].v_samp_factor = 1;
  if (progressive) {
    jpeg_simple_progression(&picture);
  }
  jpeg_start_compress(&picture, TRUE);
  std::vector<std::uint8_t> row;
  for (int x = 0; x < width_px; ++x) {
    row.insert(row.end(), rgb.begin(), rgb.end());
  }
  while (picture.next_scanline < picture.image_height) {
    JSAMPROW pixels = row.data();
    jpeg_write_scanlines(&picture, &pixels, 1);
  }
  jpeg_finish_compress(&picture);
  std::vector<std::uint8_t> jpeg(bytes, bytes + size);
  std::free(bytes);
  jpeg_destroy_compress(&picture);
  return jpeg;
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
