#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

#include "facet/error.hpp"
#include "facet/printable.hpp"
#include "files/ply.hpp"

namespace facet::files {
namespace {

constexpr std::size_t kMostElements =
    50'000'000;  // more than any mesh of ours; keeps sizes far from overflow
constexpr std::size_t kMostProperties = 64;

enum class Format { Ascii, LittleEndian, BigEndian };
enum class Type { Int8, Uint8, Int16, Uint16, Int32, Uint32, Float32, Float64 };

struct TypeName {
  std::string_view name;
  Type type;
};
constexpr TypeName kTypeNames[] = {
    {"char", Type::Int8},      {"int8", Type::Int8},       {"uchar", Type::Uint8},
    {"uint8", Type::Uint8},    {"short", Type::Int16},     {"int16", Type::Int16},
    {"ushort", Type::Uint16},  {"uint16", Type::Uint16},   {"int", Type::Int32},
    {"int32", Type::Int32},    {"uint", Type::Uint32},     {"uint32", Type::Uint32},
    {"float", Type::Float32},  {"float32", Type::Float32}, {"double", Type::Float64},
    {"float64", Type::Float64}};

bool is_integer(Type type) {
  return type != Type::Float32 && type != Type::Float64;
}

std::size_t size_of(Type type) {
  switch (type) {
    case Type::Int8:
    case Type::Uint8:
      return 1;
    case Type::Int16:
    case Type::Uint16:
      return 2;
    case Type::Int32:
    case Type::Uint32:
    case Type::Float32:
      return 4;
    case Type::Float64:
      return 8;
  }
  return 8;
}

struct Property {
  std::string name;
  Type type = Type::Float32;
  bool is_list = false;
  Type count_type = Type::Uint8;  ///< of a list
};

struct Element {
  std::string name;
  std::size_t count = 0;
  std::vector<Property> properties;
};

struct Header {
  Format format = Format::Ascii;
  std::vector<Element> elements;
  std::size_t body = 0;  ///< where the first element begins
};

[[noreturn]] void refuse(const std::string& source, const std::string& why) {
  throw Error(ErrorKind::UnreadableInput, fmt::format("{}: not a PLY file: {}", source, printable(why)));
}

std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> words;
  while (!line.empty()) {
    const std::size_t end = std::min(line.find_first_of(" \t"), line.size());
    if (end > 0) {
      words.push_back(line.substr(0, end));
    }
    line.remove_prefix(std::min(end + 1, line.size()));
  }
  return words;
}

/// Reads the header's lines one by one; `complain` names the line.
class HeaderParser {
 public:
  HeaderParser(std::string_view text, const std::string& source) : text_(text), source_(source) {}

  Header parse() {
    if (next_line() != "ply") {
      refuse(source_, "it does not begin with 'ply'");
    }
    bool has_format = false;
    for (;;) {
      const std::string_view line = next_line();
      const auto words = words_of(line);
      if (words.empty() || words[0] == "comment" || words[0] == "obj_info") {
        continue;
      }
      if (words[0] == "end_header") {
        break;
      }
      if (words[0] == "format" && words.size() == 3) {
        header_.format = format_of(words[1]);
        has_format = true;
      } else if (words[0] == "element" && words.size() == 3) {
        add_element(words);
      } else if (words[0] == "property" && (words.size() == 3 || words.size() == 5)) {
        add_property(words);
      } else {
        complain(fmt::format("'{}' is not understood", line));
      }
    }
    if (!has_format) {
      refuse(source_, "its header lacks the format");
    }
    header_.body = at_;
    return std::move(header_);
  }

 private:
  [[noreturn]] void complain(const std::string& why) const {
    refuse(source_, fmt::format("line {}: {}", line_number_, why));
  }

  std::string_view next_line() {
    constexpr std::size_t kLongestLine = 4096;
    const std::size_t end = text_.find('\n', at_);
    if (end == std::string_view::npos || end - at_ > kLongestLine) {
      refuse(source_, line_number_ == 0 ? "it does not begin with 'ply'" : "its header has no end");
    }
    std::string_view line = text_.substr(at_, end - at_);
    if (line.ends_with('\r')) {
      line.remove_suffix(1);
    }
    at_ = end + 1;
    ++line_number_;
    return line;
  }

  Format format_of(std::string_view word) const {
    if (word == "ascii") {
      return Format::Ascii;
    }
    if (word != "binary_little_endian" && word != "binary_big_endian") {
      complain(fmt::format("format '{}' is none of ascii, binary_little_endian and binary_big_endian", word));
    }
    return word == "binary_big_endian" ? Format::BigEndian : Format::LittleEndian;
  }

  void add_element(const std::vector<std::string_view>& words) {
    const std::string_view word = words[2];
    std::size_t count = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), count);
    if (error != std::errc() || end != word.data() + word.size() || count > kMostElements) {
      complain(fmt::format("'{}' is not a number of elements up to {}", word, kMostElements));
    }
    if (words[1] == "tristrips" && count > 0) {
      complain("its faces are triangle strips: save it with faces");
    }
    const auto is_same = [&](const Element& element) { return element.name == words[1]; };
    if (header_.elements.size() >= kMostProperties ||
        std::any_of(header_.elements.begin(), header_.elements.end(), is_same)) {
      complain(fmt::format("element '{}' is one too many", words[1]));
    }
    header_.elements.push_back({std::string(words[1]), count, {}});
  }

  Type type_of(std::string_view word) const {
    const auto* found = std::find_if(std::begin(kTypeNames), std::end(kTypeNames),
                                     [&](const TypeName& one) { return one.name == word; });
    if (found == std::end(kTypeNames)) {
      complain(fmt::format("property type '{}' is unknown", word));
    }
    return found->type;
  }

  void add_property(const std::vector<std::string_view>& words) {
    if (header_.elements.empty() || header_.elements.back().properties.size() >= kMostProperties) {
      complain("a property without its element, or one too many");
    }
    Property property;
    property.name = words.back();
    property.is_list = words.size() == 5;
    property.type = type_of(words[words.size() - 2]);
    if (property.is_list) {
      property.count_type = type_of(words[2]);
      if (words[1] != "list" || !is_integer(property.count_type)) {
        complain(fmt::format("'{} {} ...' is not a list with a count", words[1], words[2]));
      }
    }
    header_.elements.back().properties.push_back(std::move(property));
  }

  std::string_view text_;
  const std::string& source_;
  Header header_;
  std::size_t at_ = 0;
  std::size_t line_number_ = 0;
};

/// Numbers one after the other out of a binary body.
class BinaryNumbers {
 public:
  BinaryNumbers(std::span<const std::byte> bytes, bool swapped, const std::string& source)
      : bytes_(bytes), swapped_(swapped), source_(source) {}

  double next(Type type) {
    switch (type) {
      case Type::Int8:
        return raw<std::int8_t>();
      case Type::Uint8:
        return raw<std::uint8_t>();
      case Type::Int16:
        return raw<std::int16_t>();
      case Type::Uint16:
        return raw<std::uint16_t>();
      case Type::Int32:
        return raw<std::int32_t>();
      case Type::Uint32:
        return raw<std::uint32_t>();
      case Type::Float32:
        return static_cast<double>(raw<float>());
      case Type::Float64:
        return raw<double>();
    }
    return 0;
  }
  /// How many numbers of `size` bytes may still come.
  std::size_t room_for(std::size_t size) const { return (bytes_.size() - at_) / size; }
  bool at_end() const { return at_ == bytes_.size(); }

 private:
  template <typename Number>
  Number raw() {
    if (bytes_.size() - at_ < sizeof(Number)) {
      refuse(source_, "it ends before all its header names: cut off?");
    }
    std::byte copy[sizeof(Number)];
    std::memcpy(copy, bytes_.data() + at_, sizeof(Number));
    if (swapped_) {
      std::reverse(std::begin(copy), std::end(copy));
    }
    at_ += sizeof(Number);
    Number number;
    std::memcpy(&number, copy, sizeof(Number));
    return number;
  }

  std::span<const std::byte> bytes_;
  bool swapped_;
  const std::string& source_;
  std::size_t at_ = 0;
};

/// Numbers one after the other out of a text; line ends count as spaces.
class TextNumbers {
 public:
  TextNumbers(std::string_view text, const std::string& source) : text_(text), source_(source) {}

  double next(Type type) {
    skip_spaces();
    if (at_ == text_.size()) {
      refuse(source_, "it ends before all its header names: cut off?");
    }
    const char* const begin = text_.data() + at_ + (text_[at_] == '+' ? 1 : 0);
    double number = 0;
    const auto [end, error] = std::from_chars(begin, text_.data() + text_.size(), number);
    if (error != std::errc() || (end != text_.data() + text_.size() && !is_space(*end)) ||
        (is_integer(type) && number != std::trunc(number))) {
      refuse(source_, fmt::format("'{}' in its body is not the number that its header names",
                                  text_.substr(at_, std::min(text_.find_first_of(" \t\r\n", at_) - at_,
                                                             std::size_t{20}))));
    }
    at_ = static_cast<std::size_t>(end - text_.data());
    return number;
  }
  /// A number takes a character and a space.
  std::size_t room_for(std::size_t) const { return (text_.size() - at_ + 1) / 2; }
  bool at_end() {
    skip_spaces();
    return at_ == text_.size();
  }

 private:
  static bool is_space(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }
  void skip_spaces() {
    while (at_ < text_.size() && is_space(text_[at_])) {
      ++at_;
    }
  }

  std::string_view text_;
  const std::string& source_;
  std::size_t at_ = 0;
};

/// Reads the elements of a body. Numbers: BinaryNumbers or TextNumbers.
template <typename Numbers>
class BodyReader {
 public:
  BodyReader(const Header& header, Numbers numbers, const std::string& source)
      : header_(header), numbers_(std::move(numbers)), source_(source) {}

  PlySurface read() {
    for (const Element& element : header_.elements) {
      check_room(element);
      if (element.name == "vertex") {
        read_vertices(element);
      } else if (element.name == "face") {
        read_faces(element);
      } else {
        for (std::size_t k = 0; k < (element.properties.empty() ? 0 : element.count); ++k) {
          for (const Property& property : element.properties) {
            pass_over(property);
          }
        }
      }
    }
    if (!numbers_.at_end()) {
      refuse(source_, "more follows than its header names");
    }
    check_corners();
    return std::move(surface_);
  }

 private:
  /// Before memory is taken for them: whether so many elements can be there.
  void check_room(const Element& element) const {
    std::size_t smallest = 0;
    for (const Property& property : element.properties) {
      smallest += size_of(property.is_list ? property.count_type : property.type);
    }
    const std::size_t room = header_.format == Format::Ascii && !element.properties.empty()
                                 ? numbers_.room_for(1) / element.properties.size()
                                 : numbers_.room_for(std::max<std::size_t>(smallest, 1));
    if (!element.properties.empty() && element.count > room) {
      refuse(source_, fmt::format("its header names {} of element '{}', the file has room for {}: cut off?",
                                  element.count, element.name, room));
    }
  }

  std::size_t next_count(const Property& list) {
    const double count = numbers_.next(list.count_type);
    if (!(count >= 0) || count > static_cast<double>(numbers_.room_for(size_of(list.type)))) {
      refuse(source_, fmt::format("a list '{}' of {} numbers does not fit into the file", list.name, count));
    }
    return static_cast<std::size_t>(count);
  }

  void pass_over(const Property& property) {
    const std::size_t count = property.is_list ? next_count(property) : 1;
    for (std::size_t k = 0; k < count; ++k) {
      numbers_.next(property.type);
    }
  }

  void read_vertices(const Element& element) {
    surface_.vertex_count = element.properties.empty() ? 0 : element.count;
    std::vector<std::size_t> fields;  // of each property; beyond the end: a list
    for (const Property& property : element.properties) {
      fields.push_back(property.is_list ? element.properties.size() : surface_.names.size());
      if (!property.is_list) {
        surface_.names.push_back(property.name);
        surface_.values.emplace_back(surface_.vertex_count);
      }
    }
    for (std::size_t v = 0; v < surface_.vertex_count; ++v) {
      for (std::size_t k = 0; k < fields.size(); ++k) {
        if (element.properties[k].is_list) {
          pass_over(element.properties[k]);
        } else {
          surface_.values[fields[k]][v] = static_cast<float>(numbers_.next(element.properties[k].type));
        }
      }
    }
  }

  void read_faces(const Element& element) {
    const auto is_corners = [](const Property& property) {
      return property.is_list && (property.name == "vertex_indices" || property.name == "vertex_index");
    };
    const auto corners = std::find_if(element.properties.begin(), element.properties.end(), is_corners);
    if (element.count > 0 && (corners == element.properties.end() || !is_integer(corners->type))) {
      refuse(source_, "its faces lack a list vertex_indices of integers");
    }
    surface_.corners.reserve(3 * element.count);
    for (std::size_t f = 0; f < element.count; ++f) {
      for (const Property& property : element.properties) {
        if (&property == &*corners) {
          read_polygon(property, f);
        } else {
          pass_over(property);
        }
      }
    }
  }

  void read_polygon(const Property& list, std::size_t face) {
    const std::size_t count = next_count(list);
    if (count < 3) {
      refuse(source_, fmt::format("face {} has {} corners", face, count));
    }
    const std::int32_t first = next_corner(list, face);
    std::int32_t last = next_corner(list, face);
    for (std::size_t k = 2; k < count; ++k) {
      const std::int32_t corner = next_corner(list, face);
      surface_.corners.insert(surface_.corners.end(), {first, last, corner});
      last = corner;
    }
  }

  std::int32_t next_corner(const Property& list, std::size_t face) {
    const double corner = numbers_.next(list.type);
    if (!(corner >= 0) || corner > std::numeric_limits<std::int32_t>::max()) {
      refuse(source_, fmt::format("face {} names vertex {}, which is not there", face, corner));
    }
    return static_cast<std::int32_t>(corner);
  }

  /// Once all is read: faces may stand before the vertices.
  void check_corners() const {
    const auto largest = std::max_element(surface_.corners.begin(), surface_.corners.end());
    if (largest != surface_.corners.end() && static_cast<std::size_t>(*largest) >= surface_.vertex_count) {
      refuse(source_, fmt::format("a face names vertex {} of {}", *largest, surface_.vertex_count));
    }
  }

  const Header& header_;
  Numbers numbers_;
  const std::string& source_;
  PlySurface surface_;
};

}  // namespace

const std::vector<float>* PlySurface::find(std::string_view name) const {
  const auto found = std::find(names.begin(), names.end(), name);
  return found == names.end() ? nullptr : &values[static_cast<std::size_t>(found - names.begin())];
}

PlySurface parse_ply(std::span<const std::byte> bytes, const std::string& source) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  const Header header = HeaderParser(text, source).parse();
  if (header.format == Format::Ascii) {
    return BodyReader(header, TextNumbers(text.substr(header.body), source), source).read();
  }
  const bool swapped =
      (header.format == Format::LittleEndian) != (std::endian::native == std::endian::little);
  return BodyReader(header, BinaryNumbers(bytes.subspan(header.body), swapped, source), source).read();
}

}  // namespace facet::files
