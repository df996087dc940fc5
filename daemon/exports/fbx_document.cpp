#include "exports/fbx_document.hpp"

#include <algorithm>
#include <cstring>
#include <iterator>

#include "facet/error.hpp"

namespace facet::exports {
namespace {

constexpr std::size_t kHead = 27;  // "Kaydara FBX Binary", version
constexpr std::size_t kRecordHead =
    25;                                // end, property count, their length, the name's length; all 0: the end
constexpr std::size_t kFootMark = 16;  // then 1 to 16 zeros up to a multiple of 16
constexpr std::size_t kFoot = 4 + 4 + 120 + 16;  // zeros, version, zeros, magic
constexpr std::uint32_t kOldestVersion = 7500;   // 64-bit offsets

[[noreturn]] void fail(const char* what) {
  throw Error(ErrorKind::Internal, std::string("export: an FBX file as it was not expected: ") + what);
}

template <typename T>
T value_at(std::span<const std::byte> bytes, std::size_t at) {
  if (at > bytes.size() || bytes.size() - at < sizeof(T)) {
    fail("it ends early");
  }
  T value{};
  std::memcpy(&value, bytes.data() + at, sizeof(T));
  return value;
}

template <typename T>
void put(std::vector<std::byte>& out, const T& value) {
  const auto bytes = std::as_bytes(std::span(&value, 1));
  out.insert(out.end(), bytes.begin(), bytes.end());
}

void put(std::vector<std::byte>& out, std::span<const std::byte> bytes) {
  out.insert(out.end(), bytes.begin(), bytes.end());
}

std::span<const std::byte> part(std::span<const std::byte> bytes, std::size_t at, std::size_t length) {
  if (at > bytes.size() || bytes.size() - at < length) {
    fail("it ends early");
  }
  return bytes.subspan(at, length);
}

/// The next multiple of 16.
std::size_t after_padding(std::size_t at) {
  return (at / 16 + 1) * 16;
}

/// Reads records up to the one that is all 0 or to the end; `at` is moved behind them.
std::vector<FbxRecord> read_records(std::span<const std::byte> bytes, std::size_t& at, std::size_t end,
                                    int depth) {
  if (depth > 16 || end > bytes.size()) {
    fail("records lie in records");
  }
  std::vector<FbxRecord> records;
  while (at < end) {
    const auto record_end = value_at<std::uint64_t>(bytes, at);
    if (record_end == 0) {
      at += kRecordHead;
      return records;
    }
    FbxRecord record;
    record.property_count = value_at<std::uint64_t>(bytes, at + 8);
    const auto length = value_at<std::uint64_t>(bytes, at + 16);
    const auto name_length = value_at<std::uint8_t>(bytes, at + 24);
    const auto name = part(bytes, at + kRecordHead, name_length);
    record.name.assign(reinterpret_cast<const char*>(name.data()), name.size());
    at += kRecordHead + name_length;
    const auto properties = part(bytes, at, length);
    record.properties.assign(properties.begin(), properties.end());
    at += length;
    if (record_end < at || record_end > end) {
      fail("a record ends where it can't");
    }
    record.has_list = at < record_end;
    record.children = read_records(bytes, at, record_end, depth + 1);
    if (at != record_end) {
      fail("a record is longer than what it holds");
    }
    records.push_back(std::move(record));
  }
  return records;
}

void write_records(const std::vector<FbxRecord>& records, std::vector<std::byte>& out) {
  for (const FbxRecord& record : records) {
    const std::size_t begin = out.size();
    put(out, std::uint64_t{0});
    put(out, record.property_count);
    put(out, std::uint64_t{record.properties.size()});
    put(out, static_cast<std::uint8_t>(record.name.size()));
    put(out, std::as_bytes(std::span(record.name)));
    put(out, std::span<const std::byte>(record.properties));
    write_records(record.children, out);
    if (record.has_list || !record.children.empty()) {  // its end, which Assimp leaves out of some
      out.resize(out.size() + kRecordHead);
    }
    const std::uint64_t end = out.size();
    std::memcpy(out.data() + begin, &end, sizeof(end));
  }
}

/// Of a property with its letter, and the letter's meaning.
std::size_t property_size(std::span<const std::byte> bytes, std::size_t at) {
  constexpr std::size_t kArrayHead = 1 + 4 + 4 + 4;  // letter, count, encoding, length
  switch (static_cast<char>(value_at<std::uint8_t>(bytes, at))) {
    case 'C':
    case 'B':
      return 1 + 1;
    case 'Y':
      return 1 + 2;
    case 'I':
    case 'F':
      return 1 + 4;
    case 'L':
    case 'D':
      return 1 + 8;
    case 'S':
    case 'R':
      return 1 + 4 + std::size_t{value_at<std::uint32_t>(bytes, at + 1)};
    case 'b':
    case 'c':
    case 'i':
    case 'f':
    case 'l':
    case 'd':
      return kArrayHead + std::size_t{value_at<std::uint32_t>(bytes, at + 9)};
    default:
      fail("a property of an unknown kind");
  }
}

template <typename T>
void put_array(FbxRecord& record, char letter, std::span<const T> values) {
  ++record.property_count;
  put(record.properties, letter);
  put(record.properties, static_cast<std::uint32_t>(values.size()));
  put(record.properties, std::uint32_t{0});  // not compressed
  put(record.properties, static_cast<std::uint32_t>(values.size_bytes()));
  put(record.properties, std::as_bytes(values));
}

template <typename T>
void put_value(FbxRecord& record, char letter, const T& value) {
  ++record.property_count;
  put(record.properties, letter);
  put(record.properties, value);
}

}  // namespace

FbxRecord& FbxRecord::add(std::int32_t value) {
  put_value(*this, 'I', value);
  return *this;
}
FbxRecord& FbxRecord::add(std::int64_t value) {
  put_value(*this, 'L', value);
  return *this;
}
FbxRecord& FbxRecord::add(double value) {
  put_value(*this, 'D', value);
  return *this;
}
FbxRecord& FbxRecord::add(std::string_view text) {
  put_value(*this, 'S', static_cast<std::uint32_t>(text.size()));
  put(properties, std::as_bytes(std::span(text)));
  return *this;
}
FbxRecord& FbxRecord::add(std::span<const std::int32_t> values) {
  put_array(*this, 'i', values);
  return *this;
}
FbxRecord& FbxRecord::add(std::span<const std::int64_t> values) {
  put_array(*this, 'l', values);
  return *this;
}
FbxRecord& FbxRecord::add(std::span<const float> values) {
  put_array(*this, 'f', values);
  return *this;
}

FbxRecord& FbxRecord::child(std::string_view called) {
  return children.emplace_back(called);
}

FbxRecord& FbxRecord::find(std::string_view called) {
  const auto found = std::find_if(children.begin(), children.end(),
                                  [&](const FbxRecord& record) { return record.name == called; });
  if (found == children.end()) {
    fail("a record is missing");
  }
  return *found;
}

std::vector<std::span<const std::byte>> FbxRecord::split_properties() const {
  std::vector<std::span<const std::byte>> parts;
  for (std::size_t at = 0; at < properties.size(); at += parts.back().size()) {
    parts.push_back(part(properties, at, property_size(properties, at)));
  }
  if (parts.size() != property_count) {
    fail("another number of properties");
  }
  return parts;
}

std::int64_t fbx_integer(std::span<const std::byte> property) {
  switch (static_cast<char>(value_at<std::uint8_t>(property, 0))) {
    case 'I':
      return value_at<std::int32_t>(property, 1);
    case 'L':
      return value_at<std::int64_t>(property, 1);
    default:
      fail("a whole number was expected");
  }
}

std::string_view fbx_text(std::span<const std::byte> property) {
  if (static_cast<char>(value_at<std::uint8_t>(property, 0)) != 'S') {
    fail("text was expected");
  }
  return {reinterpret_cast<const char*>(property.data()) + 5, property.size() - 5};
}

FbxDocument::FbxDocument(std::span<const std::byte> bytes) {
  constexpr std::string_view kMagic("Kaydara FBX Binary  \0\x1A\0", 23);
  const auto head = part(bytes, 0, kHead);
  if (std::memcmp(head.data(), kMagic.data(), kMagic.size()) != 0 ||
      value_at<std::uint32_t>(bytes, kMagic.size()) < kOldestVersion) {
    fail("its magic or version");
  }
  head_.assign(head.begin(), head.end());
  std::size_t at = kHead;
  root.children = read_records(bytes, at, bytes.size(), 0);
  const auto mark = part(bytes, at, kFootMark);
  at = after_padding(at + kFootMark);
  if (bytes.size() - std::min(at, bytes.size()) != kFoot ||
      value_at<std::uint32_t>(bytes, at + 4) != value_at<std::uint32_t>(bytes, kMagic.size())) {
    fail("its foot");
  }
  tail_.assign(mark.begin(), mark.end());
  put(tail_, bytes.subspan(at));
}

std::vector<std::byte> FbxDocument::bytes() const {
  std::vector<std::byte> out = head_;
  write_records(root.children, out);
  out.resize(out.size() + kRecordHead);
  const std::span<const std::byte> tail(tail_);
  put(out, tail.first(kFootMark));
  out.resize(after_padding(out.size()));
  put(out, tail.subspan(kFootMark));
  return out;
}

}  // namespace facet::exports
