#include "files/image_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <type_traits>
#include <utility>

// After <cstdio>, which it needs and does not name.
#include <jerror.h>
#include <jpeglib.h>
#include <png.h>

#include "facet/error.hpp"
#include "files/text_file.hpp"

// Both libraries leave their functions with a jump where they cannot go on: no object that must be destroyed
// may live between a setjmp and its calls.

namespace facet::files {
namespace {

constexpr std::size_t kMostBytes = std::size_t{1} << 30;

[[noreturn]] void refuse(const std::string& source, const std::string& why) {
  throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", source, why));
}

void check_size(std::size_t width_px, std::size_t height_px, std::size_t most_pixels,
                const std::string& source) {
  constexpr auto kMostSide = static_cast<std::size_t>(kMostImageSide_px);
  if (width_px < 1 || height_px < 1 || width_px > kMostSide || height_px > kMostSide ||
      width_px * height_px > most_pixels) {
    refuse(source, fmt::format("a picture of {}x{} px; at most {} px a side and {} in all are read", width_px,
                               height_px, kMostImageSide_px, most_pixels));
  }
}

/// What went wrong in a library, kept over its jump.
class Failure {
 public:
  void set(const char* message) { std::snprintf(text_.data(), text_.size(), "%s", message); }
  std::string text() const { return text_.data(); }

 private:
  std::array<char, 200> text_{};
};

class PngReader {
 public:
  explicit PngReader(std::span<const std::byte> bytes) : rest_(bytes) {}
  ~PngReader() { png_destroy_read_struct(&png_, &info_, nullptr); }
  PngReader(const PngReader&) = delete;
  PngReader& operator=(const PngReader&) = delete;

  /// False: failure() says why.
  bool read_head() {
    if (setjmp(escape_) != 0) {
      return false;
    }
    png_ = png_create_read_struct(PNG_LIBPNG_VER_STRING, this, jump, say_nothing);
    info_ = png_ == nullptr ? nullptr : png_create_info_struct(png_);
    if (info_ == nullptr) {
      failure_.set("libpng does not start: out of memory, or of another version");
      return false;
    }
    png_set_read_fn(png_, this, read);
    png_set_user_limits(png_, PNG_UINT_31_MAX, PNG_UINT_31_MAX);  // check_size names them
    // Texts, colour profiles and the like could be unpacked to many times their size.
    png_set_keep_unknown_chunks(png_, PNG_HANDLE_CHUNK_NEVER, nullptr, -1);
    png_read_info(png_, info_);
    return true;
  }

  /// rows  [height], each of 3 values a pixel
  bool read_rows(bool sixteen_bits, std::span<png_bytep> rows) {
    if (setjmp(escape_) != 0) {
      return false;
    }
    png_set_expand(png_);
    png_set_strip_alpha(png_);
    png_set_gray_to_rgb(png_);
    if (sixteen_bits) {
      png_set_expand_16(png_);
      png_set_swap(png_);
    } else {
      png_set_scale_16(png_);
    }
    png_set_interlace_handling(png_);
    png_read_update_info(png_, info_);
    if (png_get_rowbytes(png_, info_) != width_px() * (sixteen_bits ? 6 : 3)) {
      png_error(png_, "libpng makes rows of another length");
    }
    png_read_image(png_, rows.data());
    png_read_end(png_, nullptr);
    return true;
  }

  std::size_t width_px() const { return png_get_image_width(png_, info_); }
  std::size_t height_px() const { return png_get_image_height(png_, info_); }
  std::string failure() const { return failure_.text(); }

 private:
  [[noreturn]] static void jump(png_structp png, png_const_charp message) {
    auto& self = *static_cast<PngReader*>(png_get_error_ptr(png));
    self.failure_.set(message);
    std::longjmp(self.escape_, 1);
  }
  static void say_nothing(png_structp, png_const_charp) {}
  static void read(png_structp png, png_bytep to, std::size_t count) {
    auto& self = *static_cast<PngReader*>(png_get_io_ptr(png));
    if (count > self.rest_.size()) {
      png_error(png, "it ends too soon");
    }
    std::memcpy(to, self.rest_.data(), count);
    self.rest_ = self.rest_.subspan(count);
  }

  std::span<const std::byte> rest_;
  png_structp png_ = nullptr;
  png_infop info_ = nullptr;
  std::jmp_buf escape_{};
  Failure failure_;
};

template <typename Value>
RgbImage<Value> parse_png(std::span<const std::byte> bytes, const std::string& source,
                          std::size_t most_pixels) {
  PngReader reader(bytes);
  if (!reader.read_head()) {
    refuse(source, "not a readable PNG picture: " + reader.failure());
  }
  check_size(reader.width_px(), reader.height_px(), most_pixels, source);
  RgbImage<Value> image{static_cast<int>(reader.width_px()), static_cast<int>(reader.height_px()), {}};
  const std::size_t row = 3 * reader.width_px();
  image.values.resize(row * reader.height_px());
  std::vector<png_bytep> rows(reader.height_px());
  for (std::size_t y = 0; y < rows.size(); ++y) {
    rows[y] = reinterpret_cast<png_bytep>(&image.values[row * y]);
  }
  if (!reader.read_rows(sizeof(Value) == 2, rows)) {
    refuse(source, "a damaged PNG picture: " + reader.failure());
  }
  return image;
}

class JpegReader {
 public:
  explicit JpegReader(std::span<const std::byte> bytes) : bytes_(bytes) {
    picture_.err = jpeg_std_error(&errors_);
    errors_.error_exit = jump;
    errors_.emit_message = keep_warning;
    errors_.output_message = say_nothing;
    picture_.client_data = this;
  }
  ~JpegReader() { jpeg_destroy_decompress(&picture_); }
  JpegReader(const JpegReader&) = delete;
  JpegReader& operator=(const JpegReader&) = delete;

  /// False: failure() says why.
  bool read_head() {
    if (setjmp(escape_) != 0) {
      return false;
    }
    jpeg_create_decompress(&picture_);
    progress_.progress_monitor = watch_scans;
    picture_.progress = &progress_;
    jpeg_save_markers(&picture_, kExifMarker, 0xFFFF);
    jpeg_mem_src(&picture_, reinterpret_cast<const unsigned char*>(bytes_.data()), bytes_.size());
    jpeg_read_header(&picture_, TRUE);
    picture_.out_color_space = JCS_RGB;
    return true;
  }

  /// rgb  [height][width][3]
  bool read_rows(std::uint8_t* rgb) {
    if (setjmp(escape_) != 0) {
      return false;
    }
    jpeg_start_decompress(&picture_);
    while (picture_.output_scanline < picture_.output_height) {
      JSAMPROW row = rgb + picture_.output_scanline * std::size_t{3} * picture_.output_width;
      jpeg_read_scanlines(&picture_, &row, 1);
    }
    return !damaged_;
  }

  std::size_t width_px() const { return picture_.image_width; }
  std::size_t height_px() const { return picture_.image_height; }
  bool has_ink() const {
    return picture_.jpeg_color_space == JCS_CMYK || picture_.jpeg_color_space == JCS_YCCK;
  }
  std::string failure() const { return failure_.text(); }

  /// How the camera was held: 1 (upright) to 8, as EXIF numbers it.
  int orientation() const {
    for (const auto* marker = picture_.marker_list; marker != nullptr; marker = marker->next) {
      if (marker->marker == kExifMarker) {
        return orientation_of(std::as_bytes(std::span(marker->data, marker->data_length)));
      }
    }
    return 1;
  }

 private:
  static constexpr int kExifMarker = JPEG_APP0 + 1;
  /// A few bytes of a progressive picture can ask for thousands of passes over it.
  static constexpr int kMostScans = 200;

  /// Exif: "Exif\0\0", a TIFF head of 8 bytes, a list of entries of 12; tag 0x0112 is a short.
  static int orientation_of(std::span<const std::byte> exif) {
    constexpr std::array kHead = {std::byte{'E'}, std::byte{'x'}, std::byte{'i'},
                                  std::byte{'f'}, std::byte{0},   std::byte{0}};
    if (exif.size() < kHead.size() + 8 || !std::equal(kHead.begin(), kHead.end(), exif.begin())) {
      return 1;
    }
    const auto tiff = exif.subspan(kHead.size());
    const bool big_endian = tiff[0] == std::byte{'M'};
    const auto number = [&](std::size_t at, std::size_t size) {
      std::uint32_t value = 0;
      for (std::size_t i = 0; i < size; ++i) {
        const std::size_t from = at + (big_endian ? i : size - 1 - i);
        value = value << 8U | std::to_integer<std::uint32_t>(tiff[from]);
      }
      return value;
    };
    const std::size_t list = number(4, 4);
    if (list > tiff.size() - 2) {
      return 1;
    }
    const std::size_t count = std::min<std::size_t>(number(list, 2), (tiff.size() - list - 2) / 12);
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t entry = list + 2 + 12 * i;
      if (number(entry, 2) == 0x0112) {
        const std::uint32_t value = number(entry + 8, 2);
        return value >= 1 && value <= 8 ? static_cast<int>(value) : 1;
      }
    }
    return 1;
  }

  static JpegReader& self_of(j_common_ptr common) { return *static_cast<JpegReader*>(common->client_data); }
  void keep_message(j_common_ptr common) {
    std::array<char, JMSG_LENGTH_MAX> message{};
    common->err->format_message(common, message.data());
    failure_.set(message.data());
  }
  [[noreturn]] static void jump(j_common_ptr common) {
    JpegReader& self = self_of(common);
    if (!self.damaged_) {
      self.keep_message(common);
    }
    std::longjmp(self.escape_, 1);
  }
  static void keep_warning(j_common_ptr common, int level) {
    // Some cameras put bytes between a picture's parts; nothing of it is lost.
    const int code = common->err->msg_code;
    if (level >= 0 || code == JWRN_EXTRANEOUS_DATA || code == JWRN_JFIF_MAJOR || code == JWRN_ADOBE_XFORM) {
      return;
    }
    JpegReader& self = self_of(common);
    if (!self.damaged_) {
      self.keep_message(common);
      self.damaged_ = true;
    }
  }
  static void say_nothing(j_common_ptr) {}
  static void watch_scans(j_common_ptr common) {
    JpegReader& self = self_of(common);
    if (common->is_decompressor != 0 && self.picture_.input_scan_number > kMostScans) {
      self.failure_.set("more scans than a picture has");
      std::longjmp(self.escape_, 1);
    }
  }

  std::span<const std::byte> bytes_;
  jpeg_error_mgr errors_{};
  jpeg_progress_mgr progress_{};
  jpeg_decompress_struct picture_{};
  std::jmp_buf escape_{};
  Failure failure_;
  bool damaged_ = false;
};

/// The picture as it is seen upright. orientation: EXIF's number, which says where the first row and the
/// first column are to be: 2 to 4 mirror and turn by 180 degrees, 5 to 8 change rows for columns.
RgbImage<std::uint8_t> upright(RgbImage<std::uint8_t> from, int orientation) {
  if (orientation == 1) {
    return from;
  }
  const bool swapped = orientation >= 5;
  RgbImage<std::uint8_t> out{from.width_px, from.height_px, std::vector<std::uint8_t>(from.values.size())};
  if (swapped) {
    std::swap(out.width_px, out.height_px);
  }
  const bool flip_x = orientation == 2 || orientation == 3 || orientation == 7 || orientation == 8;
  const bool flip_y = orientation == 3 || orientation == 4 || orientation == 6 || orientation == 7;
  std::uint8_t* to = out.values.data();
  for (int y = 0; y < out.height_px; ++y) {
    for (int x = 0; x < out.width_px; ++x, to += 3) {
      int column = swapped ? y : x;
      int row = swapped ? x : y;
      column = flip_x ? from.width_px - 1 - column : column;
      row = flip_y ? from.height_px - 1 - row : row;
      const auto pixel = static_cast<std::size_t>(row) * static_cast<std::size_t>(from.width_px) +
                         static_cast<std::size_t>(column);
      std::copy_n(&from.values[3 * pixel], 3, to);
    }
  }
  return out;
}

RgbImage<std::uint8_t> parse_jpeg(std::span<const std::byte> bytes, const std::string& source,
                                  std::size_t most_pixels) {
  JpegReader reader(bytes);
  if (!reader.read_head()) {
    refuse(source, "not a readable JPEG picture: " + reader.failure());
  }
  check_size(reader.width_px(), reader.height_px(), most_pixels, source);
  if (reader.has_ink()) {
    refuse(source, "a JPEG picture for printing (CMYK): save it as RGB");
  }
  RgbImage<std::uint8_t> image{static_cast<int>(reader.width_px()), static_cast<int>(reader.height_px()), {}};
  image.values.resize(3 * reader.width_px() * reader.height_px());
  if (!reader.read_rows(image.values.data())) {
    refuse(source, "a damaged JPEG picture: " + reader.failure());
  }
  return upright(std::move(image), reader.orientation());
}

bool begins_with(std::span<const std::byte> bytes, std::string_view magic) {
  return bytes.size() >= magic.size() && std::memcmp(bytes.data(), magic.data(), magic.size()) == 0;
}

class PngWriter {
 public:
  ~PngWriter() { png_destroy_write_struct(&png_, &info_); }
  PngWriter() = default;
  PngWriter(const PngWriter&) = delete;
  PngWriter& operator=(const PngWriter&) = delete;

  bool write(png_uint_32 width_px, png_uint_32 height_px, int bits, bool colour, std::span<png_bytep> rows) {
    if (setjmp(escape_) != 0) {
      return false;
    }
    png_ = png_create_write_struct(PNG_LIBPNG_VER_STRING, this, jump, say_nothing);
    info_ = png_ == nullptr ? nullptr : png_create_info_struct(png_);
    if (info_ == nullptr) {
      failure_.set("libpng does not start: out of memory, or of another version");
      return false;
    }
    png_set_write_fn(png_, this, append, nullptr);
    // Pictures are packed while somebody waits: a tenth larger than zlib's best, ten times as fast.
    png_set_filter(png_, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
    png_set_compression_level(png_, 1);
    png_set_compression_strategy(png_, 3);  // Z_RLE
    png_set_IHDR(png_, info_, width_px, height_px, bits, colour ? PNG_COLOR_TYPE_RGB : PNG_COLOR_TYPE_GRAY,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_write_info(png_, info_);
    if (bits == 16) {
      png_set_swap(png_);
    }
    png_write_image(png_, rows.data());
    png_write_end(png_, nullptr);
    return true;
  }

  std::string failure() const { return failure_.text(); }
  std::vector<std::uint8_t> take() { return std::move(bytes_); }

 private:
  [[noreturn]] static void jump(png_structp png, png_const_charp message) {
    auto& self = *static_cast<PngWriter*>(png_get_error_ptr(png));
    self.failure_.set(message);
    std::longjmp(self.escape_, 1);
  }
  static void say_nothing(png_structp, png_const_charp) {}
  static void append(png_structp png, png_bytep from, std::size_t count) {
    auto& self = *static_cast<PngWriter*>(png_get_io_ptr(png));
    try {
      self.bytes_.insert(self.bytes_.end(), from, from + count);
      return;
    } catch (const std::bad_alloc&) {
      self.failure_.set("out of memory");
    }
    std::longjmp(self.escape_, 1);
  }

  png_structp png_ = nullptr;
  png_infop info_ = nullptr;
  std::vector<std::uint8_t> bytes_;
  std::jmp_buf escape_{};
  Failure failure_;
};

class JpegWriter {
 public:
  JpegWriter() {
    picture_.err = jpeg_std_error(&errors_);
    errors_.error_exit = jump;
    errors_.output_message = say_nothing;
    picture_.client_data = this;
  }
  ~JpegWriter() { jpeg_destroy_compress(&picture_); }
  JpegWriter(const JpegWriter&) = delete;
  JpegWriter& operator=(const JpegWriter&) = delete;

  /// values  [height][width][channels]
  bool write(JDIMENSION width_px, JDIMENSION height_px, int channels, const std::uint8_t* values,
             int quality) {
    if (setjmp(escape_) != 0) {
      return false;
    }
    jpeg_create_compress(&picture_);
    target_.init_destination = begin;
    target_.empty_output_buffer = grow;
    target_.term_destination = end;
    picture_.dest = &target_;
    picture_.image_width = width_px;
    picture_.image_height = height_px;
    picture_.input_components = channels;
    picture_.in_color_space = channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
    jpeg_set_defaults(&picture_);
    jpeg_set_quality(&picture_, quality, TRUE);
    jpeg_start_compress(&picture_, TRUE);
    while (picture_.next_scanline < picture_.image_height) {
      // The library reads alone through this pointer.
      JSAMPROW row = const_cast<std::uint8_t*>(values) +
                     picture_.next_scanline * static_cast<std::size_t>(channels) * picture_.image_width;
      jpeg_write_scanlines(&picture_, &row, 1);
    }
    jpeg_finish_compress(&picture_);
    return true;
  }

  std::string failure() const { return failure_.text(); }
  std::vector<std::uint8_t> take() { return std::move(bytes_); }

 private:
  [[noreturn]] static void jump(j_common_ptr picture) {
    auto& self = *static_cast<JpegWriter*>(picture->client_data);
    std::array<char, JMSG_LENGTH_MAX> message{};
    picture->err->format_message(picture, message.data());
    self.failure_.set(message.data());
    std::longjmp(self.escape_, 1);
  }
  static void say_nothing(j_common_ptr) {}

  /// More room behind what is written.
  void give_room(std::size_t written) {
    constexpr std::size_t kLeast = std::size_t{64} << 10;
    try {
      bytes_.resize(std::max(kLeast, 2 * written));
      target_.next_output_byte = bytes_.data() + written;
      target_.free_in_buffer = bytes_.size() - written;
      return;
    } catch (const std::bad_alloc&) {
      failure_.set("out of memory");
    }
    std::longjmp(escape_, 1);
  }
  static void begin(j_compress_ptr picture) { static_cast<JpegWriter*>(picture->client_data)->give_room(0); }
  static boolean grow(j_compress_ptr picture) {
    auto& self = *static_cast<JpegWriter*>(picture->client_data);
    self.give_room(self.bytes_.size());
    return TRUE;
  }
  static void end(j_compress_ptr picture) {
    auto& self = *static_cast<JpegWriter*>(picture->client_data);
    self.bytes_.resize(self.bytes_.size() - self.target_.free_in_buffer);
  }

  jpeg_error_mgr errors_{};
  jpeg_destination_mgr target_{};
  jpeg_compress_struct picture_{};
  std::vector<std::uint8_t> bytes_;
  std::jmp_buf escape_{};
  Failure failure_;
};

/// 1 or 3. Throws Error(Internal) where the values are no picture of that size.
std::size_t channels_of(int width_px, int height_px, std::size_t values) {
  const std::size_t pixels =
      static_cast<std::size_t>(std::max(0, width_px)) * static_cast<std::size_t>(std::max(0, height_px));
  if (pixels == 0 || (values != pixels && values != 3 * pixels)) {
    throw Error(ErrorKind::Internal, fmt::format("{} values are no picture of {}x{} px, grey or RGB", values,
                                                 width_px, height_px));
  }
  return values / pixels;
}

[[noreturn]] void fail_to_encode(int width_px, int height_px, const std::string& why) {
  throw Error(ErrorKind::Internal,
              fmt::format("a picture of {}x{} px cannot be encoded: {}", width_px, height_px, why));
}

template <typename Value>
std::vector<std::uint8_t> encode(int width_px, int height_px, std::span<const Value> values) {
  const bool colour = channels_of(width_px, height_px, values.size()) == 3;
  const auto width = static_cast<std::size_t>(width_px);
  const auto height = static_cast<std::size_t>(height_px);
  std::vector<png_bytep> rows(height);
  for (std::size_t y = 0; y < height; ++y) {
    // The library reads alone through these pointers.
    rows[y] = reinterpret_cast<png_bytep>(const_cast<Value*>(&values[values.size() / height * y]));
  }
  PngWriter writer;
  if (!writer.write(static_cast<png_uint_32>(width), static_cast<png_uint_32>(height), 8 * sizeof(Value),
                    colour, rows)) {
    fail_to_encode(width_px, height_px, writer.failure());
  }
  return writer.take();
}

}  // namespace

template <typename Value>
RgbImage<Value> parse_image(std::span<const std::byte> bytes, const std::string& source,
                            std::size_t most_pixels) {
  if (begins_with(bytes, "\x89PNG\r\n\x1a\n")) {
    return parse_png<Value>(bytes, source, most_pixels);
  }
  if (!begins_with(bytes, "\xff\xd8")) {
    refuse(source, bytes.empty() ? "an empty file instead of a PNG or JPEG picture"
                                 : "neither PNG nor JPEG; ImageMagick's convert turns BMP, TIFF and others "
                                   "into PNG without loss");
  }
  RgbImage<std::uint8_t> image = parse_jpeg(bytes, source, most_pixels);
  if constexpr (std::is_same_v<Value, std::uint8_t>) {
    return image;
  } else {
    RgbImage<Value> wide{image.width_px, image.height_px, std::vector<Value>(image.values.size())};
    std::transform(image.values.begin(), image.values.end(), wide.values.begin(),
                   [](std::uint8_t value) { return static_cast<Value>(257 * value); });
    return wide;
  }
}
template RgbImage<std::uint8_t> parse_image(std::span<const std::byte>, const std::string&, std::size_t);
template RgbImage<std::uint16_t> parse_image(std::span<const std::byte>, const std::string&, std::size_t);

template <typename Value>
RgbImage<Value> read_image(const std::filesystem::path& file) {
  return parse_image<Value>(read_bytes(file, kMostBytes, "picture"), file.string());
}
template RgbImage<std::uint8_t> read_image(const std::filesystem::path&);
template RgbImage<std::uint16_t> read_image(const std::filesystem::path&);

std::vector<std::uint8_t> encode_png(int width_px, int height_px, std::span<const std::uint8_t> values) {
  return encode(width_px, height_px, values);
}
std::vector<std::uint8_t> encode_png(int width_px, int height_px, std::span<const std::uint16_t> values) {
  return encode(width_px, height_px, values);
}

std::vector<std::uint8_t> encode_jpeg(int width_px, int height_px, std::span<const std::uint8_t> values,
                                      int quality) {
  const auto channels = static_cast<int>(channels_of(width_px, height_px, values.size()));
  JpegWriter writer;
  if (!writer.write(static_cast<JDIMENSION>(width_px), static_cast<JDIMENSION>(height_px), channels,
                    values.data(), quality)) {
    fail_to_encode(width_px, height_px, writer.failure());
  }
  return writer.take();
}

}  // namespace facet::files
