#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace facet::test {

/// An AVI file of pictures that are encoded already, put together piece by piece, so that it can be wrong.
struct AviFile {
  int width_px = 0;
  int height_px = 0;
  std::uint32_t rate = 30;  ///< pictures in `scale` seconds
  std::uint32_t scale = 1;
  std::string coding = "MJPG";
  std::uint32_t aspect = 0;          ///< across in the upper 16 bits, down in the lower; 0: not said
  std::uint32_t named_pictures = 0;  ///< that its head names
  bool with_sound = false;           ///< a first stream, whose pieces lie between
  std::vector<std::vector<std::uint8_t>> pictures{};  ///< an empty one: dropped
  std::size_t second_part = SIZE_MAX;  ///< from this picture on in a second "RIFF", as beyond 1 GB

  std::string bytes() const {
    const std::string movie = list("movi", pieces(0, std::min(second_part, pictures.size())));
    std::string out =
        riff("AVI ", list("hdrl", piece("avih", number(33'333) + std::string(52, '\0')) + streams()) +
                         piece("JUNK", "nothing") + movie);
    if (second_part < pictures.size()) {
      out += riff("AVIX", list("movi", list("rec ", pieces(second_part, pictures.size()))));
    }
    return out;
  }

  static std::string number(std::uint32_t value, int size = 4) {
    std::string out;
    for (int i = 0; i < size; ++i) {
      out += static_cast<char>(value >> (8 * i) & 0xFFU);
    }
    return out;
  }
  static std::string piece(std::string_view name, const std::string& body) {
    return std::string(name) + number(static_cast<std::uint32_t>(body.size())) + body +
           (body.size() % 2 == 1 ? std::string(1, '\0') : std::string());
  }

 private:
  static std::string riff(std::string_view kind, const std::string& body) {
    return piece("RIFF", std::string(kind) + body);
  }
  static std::string list(std::string_view kind, const std::string& body) {
    return piece("LIST", std::string(kind) + body);
  }
  std::string pieces(std::size_t from, std::size_t to) const {
    std::string out;
    for (std::size_t k = from; k < to; ++k) {
      if (with_sound) {
        out += piece("00wb", std::string(7, 'x'));
      }
      out += piece(with_sound ? "01dc" : "00dc", std::string(pictures[k].begin(), pictures[k].end()));
    }
    return out;
  }
  std::string streams() const {
    const std::string picture_head =
        piece("strh", "vids" + coding + std::string(12, '\0') + number(scale) + number(rate) + number(0) +
                          number(named_pictures) + std::string(20, '\0'));
    const std::string format =
        piece("strf", number(40) + number(static_cast<std::uint32_t>(width_px)) +
                          number(static_cast<std::uint32_t>(height_px)) + number(1, 2) + number(24, 2) +
                          coding + std::string(20, '\0'));
    const std::string shape =
        aspect == 0 ? "" : piece("vprp", std::string(20, '\0') + number(aspect) + std::string(12, '\0'));
    const std::string sound = with_sound ? list("strl", piece("strh", "auds" + std::string(52, '\0')) +
                                                            piece("strf", std::string(16, '\0')))
                                         : "";
    return sound + list("strl", picture_head + format + shape);
  }
};

}  // namespace facet::test
