#include "service/web_server.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <microhttpd.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <exception>
#include <iterator>
#include <map>
#include <optional>
#include <set>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "facet/system_error.hpp"
#include "files/text_file.hpp"
#include "service/http_connections.hpp"
#include "service/thumbnails.hpp"
#include "service/web_tokens.hpp"
#include "stream/web_socket.hpp"
#include "take/database.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::service {
namespace {

/// What the kernel may hold for one WebSocket, bytes: a reader that is slow is to lose old frames, not to get
/// them late.
constexpr int kSendBufferBytes = 512 << 10;
/// A peer that acknowledges nothing for so long is gone.
constexpr unsigned kSilence_ms = 20'000;
constexpr std::string_view kProtocol = "facet";
constexpr std::string_view kTokenPrefix = "facet.token.";
constexpr std::size_t kMostPageFiles = 256;

/// Nothing from elsewhere, nothing inside a frame of another page, no type guessed.
constexpr std::pair<const char*, const char*> kHeaders[] = {
    {"Content-Security-Policy",
     "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src "
     "'self'; "
     "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"},
    {"X-Content-Type-Options", "nosniff"},
    {"X-Frame-Options", "DENY"},
    {"Referrer-Policy", "no-referrer"},
    {"Cross-Origin-Opener-Policy", "same-origin"},
    {"Cross-Origin-Resource-Policy", "same-origin"},
    {"Cache-Control", "no-cache"},
};

constexpr std::pair<std::string_view, const char*> kTypes[] = {
    {".html", "text/html; charset=utf-8"},
    {".js", "text/javascript; charset=utf-8"},
    {".css", "text/css; charset=utf-8"},
    {".json", "application/json"},
    {".svg", "image/svg+xml"},
    {".png", "image/png"},
    {".txt", "text/plain; charset=utf-8"},
};

struct PageFile {
  std::string bytes;
  const char* type;
};

/// The entries of a list that commas part, without the blanks around them.
std::vector<std::string_view> entries(std::string_view list) {
  std::vector<std::string_view> found;
  while (!list.empty()) {
    const std::size_t comma = std::min(list.find(','), list.size());
    std::string_view entry = list.substr(0, comma);
    list.remove_prefix(std::min(comma + 1, list.size()));
    const std::size_t first = std::min(entry.find_first_not_of(" \t"), entry.size());
    entry.remove_prefix(first);
    entry = entry.substr(0, entry.find_last_not_of(" \t") + 1);
    if (!entry.empty()) {
      found.push_back(entry);
    }
  }
  return found;
}

/// The files of a folder, without those of folders in it, by the path at which they are asked for.
std::map<std::string, PageFile, std::less<>> read_page(const std::filesystem::path& folder) {
  std::map<std::string, PageFile, std::less<>> files;
  std::size_t bytes = 0;
  std::error_code error;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    const auto* const type = std::find_if(std::begin(kTypes), std::end(kTypes), [&](const auto& known) {
      return entry->path().extension() == known.first;
    });
    std::error_code ignored;
    if (type == std::end(kTypes) || !entry->is_regular_file(ignored)) {
      continue;
    }
    PageFile file{files::read_text(entry->path(), WebServer::kMostPageBytes, "file of the page"),
                  type->second};
    bytes += file.bytes.size();
    if (bytes > WebServer::kMostPageBytes || files.size() >= kMostPageFiles) {
      throw Error(ErrorKind::Usage,
                  fmt::format("web.page = \"{}\": that is more than a page", folder.string()));
    }
    files.emplace(fmt::format("/{}", entry->path().filename().string()), std::move(file));
  }
  if (const auto index = files.find("/index.html"); index != files.end()) {
    files.emplace("/", index->second);
  }
  return files;
}

/// The bytes [first, end) of a file.
struct ByteRange {
  std::uint64_t first = 0;
  std::uint64_t end = 0;
  bool partial = false;
};

/// What a Range header asks for; everything where that is not one range. Empty where it lies behind the end.
ByteRange byte_range(const std::string& text, std::uint64_t size) {
  constexpr std::string_view kUnit = "bytes=";
  const ByteRange all{0, size, false};
  if (size == 0 || text.rfind(kUnit, 0) != 0) {
    return all;
  }
  const auto number = [](std::string_view digits, std::uint64_t& value) {
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    return error == std::errc() && end == digits.data() + digits.size();
  };
  const std::string_view range = std::string_view(text).substr(kUnit.size());
  const std::size_t dash = std::min(range.find('-'), range.size());
  const std::string_view from = range.substr(0, dash);
  const std::string_view to = range.substr(std::min(dash + 1, range.size()));
  std::uint64_t first = 0;
  std::uint64_t last = size - 1;
  if (dash == range.size() || (!from.empty() && !number(from, first)) || (!to.empty() && !number(to, last)) ||
      (from.empty() && to.empty()) || (!from.empty() && last < first && !to.empty())) {
    return all;
  }
  if (from.empty()) {
    return {size - std::min(last, size), size, true};
  }
  return {first, std::min(last, size - 1) + 1, true};
}

/// As it may stand in a header, RFC 5987.
std::string percent_encoded(std::string_view text) {
  std::string out;
  for (const char c : text) {
    const bool plain = (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                       c == '-' || c == '_' || c == '.';
    out += plain ? std::string(1, c) : fmt::format("%{:02X}", static_cast<unsigned char>(c));
  }
  return out;
}

struct FreeResponse {
  void operator()(MHD_Response* owned) const { MHD_destroy_response(owned); }
};
using Response = std::unique_ptr<MHD_Response, FreeResponse>;

MHD_Result send(MHD_Connection* connection, unsigned status, const Response& response) {
  return response != nullptr ? MHD_queue_response(connection, status, response.get()) : MHD_NO;
}

/// A few words.
Response words(const std::string& text) {
  // The library does not write to it.
  Response response(
      MHD_create_response_from_buffer(text.size(), const_cast<char*>(text.data()), MHD_RESPMEM_MUST_COPY));
  for (const auto& [name, value] : kHeaders) {
    MHD_add_response_header(response.get(), name, value);
  }
  MHD_add_response_header(response.get(), MHD_HTTP_HEADER_CONTENT_TYPE, "text/plain; charset=utf-8");
  return response;
}

/// A folder of files as a POSIX tar archive (IEEE 1003.1-1988, ustar) that is never on the disk: its length
/// is known before, and any part of it can be read.
class TarOfFiles {
 public:
  /// Names in the archive are folder/name. False where a file is missing or none.
  bool add(const std::filesystem::path& file, const std::string& folder) {
    Entry entry;
    entry.file = file;
    struct stat status {};
    if (::lstat(file.c_str(), &status) != 0 || !S_ISREG(status.st_mode) ||
        static_cast<std::uint64_t>(status.st_size) > kMostFileBytes) {
      return false;
    }
    entry.device = status.st_dev;
    entry.inode = status.st_ino;
    entry.begin = size_ - 2 * kBlock;
    entry.bytes = static_cast<std::uint64_t>(status.st_size);
    const auto put = [&](std::size_t at, const std::string& text) {
      std::memcpy(entry.head.data() + at, text.data(), text.size());
    };
    put(0, file.filename().string());
    put(100, fmt::format("{:07o}", 0644));
    put(108, fmt::format("{:07o}", 0));
    put(116, fmt::format("{:07o}", 0));
    put(124, fmt::format("{:011o}", entry.bytes));
    put(136, fmt::format("{:011o}", std::max<std::int64_t>(0, status.st_mtim.tv_sec)));
    put(148, "        ");
    put(156, "0");
    put(257, "ustar");
    put(263, "00");
    put(345, folder);
    unsigned sum = 0;
    for (const char byte : entry.head) {
      sum += static_cast<unsigned char>(byte);
    }
    put(148, fmt::format("{:06o}", sum) + std::string("\0 ", 2));
    size_ += kBlock + (entry.bytes + kBlock - 1) / kBlock * kBlock;
    entries_.push_back(std::move(entry));
    return true;
  }
  std::uint64_t size() const { return size_; }

  /// Up to `most` bytes from `position` < size(). -1 where a file is gone, is another one or has another size
  /// than when it was added. One file is open at a time.
  ssize_t read(std::uint64_t position, char* out, std::size_t most) {
    const auto after = std::upper_bound(entries_.begin(), entries_.end(), position,
                                        [](std::uint64_t at, const Entry& one) { return at < one.begin; });
    const auto zeros = [&](std::uint64_t count) {
      const auto length = static_cast<std::size_t>(std::min<std::uint64_t>(count, most));
      std::memset(out, 0, length);
      return static_cast<ssize_t>(length);
    };
    if (after == entries_.begin()) {
      return zeros(size_ - position);
    }
    const Entry& entry = *(after - 1);
    const std::uint64_t within = position - entry.begin;
    if (within < kBlock) {
      const std::size_t length = std::min<std::size_t>(most, kBlock - static_cast<std::size_t>(within));
      std::memcpy(out, entry.head.data() + within, length);
      return static_cast<ssize_t>(length);
    }
    const std::uint64_t in_file = within - kBlock;
    if (in_file >= entry.bytes) {
      const std::uint64_t end = after == entries_.end() ? size_ : after->begin;
      return zeros(end - position);
    }
    if (!open(entry)) {
      return -1;
    }
    const ssize_t got = ::pread(
        opened_.get(), out, static_cast<std::size_t>(std::min<std::uint64_t>(most, entry.bytes - in_file)),
        static_cast<off_t>(in_file));
    return got > 0 ? got : -1;
  }

 private:
  static constexpr std::size_t kBlock = 512;
  static constexpr std::uint64_t kMostFileBytes = (std::uint64_t{1} << 33) - 1;  ///< 11 octal digits
  struct Entry {
    std::filesystem::path file;
    dev_t device = 0;
    ino_t inode = 0;
    std::array<char, kBlock> head{};
    std::uint64_t begin = 0;  ///< of its head in the archive
    std::uint64_t bytes = 0;
  };

  bool open(const Entry& entry) {
    if (opened_entry_ == &entry) {
      return true;
    }
    opened_entry_ = nullptr;
    opened_.reset();  // first: there are as many descriptors as downloads
    opened_.reset(::open(entry.file.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK));
    struct stat status {};
    if (!opened_ || ::fstat(opened_.get(), &status) != 0 || status.st_dev != entry.device ||
        status.st_ino != entry.inode || static_cast<std::uint64_t>(status.st_size) != entry.bytes) {
      return false;
    }
    opened_entry_ = &entry;
    return true;
  }

  std::vector<Entry> entries_;
  stream::FileDescriptor opened_;
  const Entry* opened_entry_ =
      nullptr;                       ///< whose opened_ is; of entries_, to which nothing is added any more
  std::uint64_t size_ = 2 * kBlock;  ///< two empty blocks are the end
};

/// A file of a take's that is downloaded as it lies on the disk.
struct WholeFile {
  const char* ending;
  const char* type;
  bool is_sound;  ///< else the take itself
};
constexpr WholeFile kTakeFile{"take", "application/vnd.facet.take", false};
constexpr WholeFile kSoundFile{"flac", "audio/flac", true};

}  // namespace

struct WebServer::Impl {
  /// What a handshake leads to.
  enum class Door : std::size_t { Stream, Look, Command, WrongToken, TooManyTokens, Count };
  /// What libmicrohttpd brings back once it has sent the answer to a handshake.
  struct Passage {
    Impl* impl;
    Door door;
  };

  Impl(const WebConfig& given, std::filesystem::path folder, FindTake find,
       stream::StreamServer& given_stream, ControlServer& given_control)
      : config(given),
        takes(std::move(folder)),
        find_take(std::move(find)),
        stream(given_stream),
        control(given_control),
        page(read_page(given.page)),
        tokens(given.token_file, given.is_public && !given.open_look),
        cookie("facet-look-" + given.listen.substr(given.listen.rfind(':') + 1)),
        hosts(own_hosts(given.listen, given.hosts)),
        connections(given.max_connections, given.max_downloads) {
    for (std::size_t door = 0; door < passages.size(); ++door) {
      passages.at(door) = {this, static_cast<Door>(door)};
    }
  }

  const WebConfig config;
  const std::filesystem::path takes;
  const FindTake find_take;
  stream::StreamServer& stream;
  ControlServer& control;
  const std::map<std::string, PageFile, std::less<>> page;
  WebTokens tokens;  ///< the server's thread only
  /// Its name; it holds the token for looking, whatever token was shown: cookies go to every port of a host.
  const std::string cookie;
  const std::set<std::string> hosts;
  HttpConnections connections;
  std::array<Passage, static_cast<std::size_t>(Door::Count)> passages{};

  mutable Mutex statistics_mutex;
  WebStatistics shown FACET_GUARDED_BY(statistics_mutex);

  MHD_Result answer(MHD_Connection* connection, const std::string& path, std::string_view method);
  MHD_Result send_thumbnail(MHD_Connection* connection, const std::string& name);
  MHD_Result refuse(MHD_Connection* connection, unsigned status, const std::string& why);
  std::string stranger(MHD_Connection* connection) const;
  MHD_Result send_page(MHD_Connection* connection, const PageFile& file) const;
  MHD_Result send_file(MHD_Connection* connection, const std::string& name, const WholeFile& what);
  MHD_Result send_frames(MHD_Connection* connection, const std::string& name);
  std::optional<TakeFiles> closed_take(MHD_Connection* connection, const std::string& name,
                                       MHD_Result& refused);
  MHD_Result shake_hands(MHD_Connection* connection, Door door);
  WebTokens::Opens try_token(MHD_Connection* connection, std::string_view shown_one);
  std::optional<std::string> shown_token(MHD_Connection* connection) const;
  bool may_look(MHD_Connection* connection, MHD_Result& refused);
  MHD_Result refuse_token(MHD_Connection* connection, WebTokens::Opens opens);
  MHD_Result answer_look(MHD_Connection* connection);
  Door door_of_token(MHD_Connection* connection, Door asked, std::string_view shown_one);
  void hand_over(Door door, stream::FileDescriptor connection, std::vector<std::uint8_t> early);

  static void on_upgrade(void* passage, MHD_Connection* connection, void* state, const char* early,
                         std::size_t early_size, MHD_socket socket, MHD_UpgradeResponseHandle* handle);

  const HttpAnswer on_request = [this](MHD_Connection* connection, const char* path,
                                       std::string_view method) { return answer(connection, path, method); };
  HttpServer server;  ///< ends before what it uses
};

MHD_Result WebServer::Impl::refuse(MHD_Connection* connection, unsigned status, const std::string& why) {
  {
    const Lock lock(statistics_mutex);
    ++shown.refused;
    shown.last_refusal = why;
  }
  const Response response = words(why + "\n");
  MHD_add_response_header(response.get(), MHD_HTTP_HEADER_CONNECTION, "close");
  if (status == MHD_HTTP_METHOD_NOT_ALLOWED) {
    MHD_add_response_header(response.get(), MHD_HTTP_HEADER_ALLOW, "GET, HEAD");
  }
  if (status == MHD_HTTP_SERVICE_UNAVAILABLE) {
    MHD_add_response_header(response.get(), MHD_HTTP_HEADER_RETRY_AFTER,
                            std::to_string(HttpConnections::kLeastBytesTime.count()).c_str());
  }
  // A cookie of before does not go on guessing; where another token was shown, it may be a good one.
  if (status == MHD_HTTP_UNAUTHORIZED && !header(connection, MHD_HTTP_HEADER_AUTHORIZATION).value) {
    MHD_add_response_header(response.get(), MHD_HTTP_HEADER_SET_COOKIE,
                            fmt::format("{}=; Path=/; HttpOnly; SameSite=Strict; Max-Age=0", cookie).c_str());
  }
  if (status == MHD_HTTP_UPGRADE_REQUIRED) {
    MHD_add_response_header(response.get(), MHD_HTTP_HEADER_SEC_WEBSOCKET_VERSION, "13");
  }
  return send(connection, status, response);
}

/// Empty where a request is for us and from us; else why it is not.
std::string WebServer::Impl::stranger(MHD_Connection* connection) const {
  if (std::string why = foreign_host(connection, hosts); !why.empty()) {
    return why;
  }
  const std::string host = lower_case(header(connection, MHD_HTTP_HEADER_HOST).value.value_or(""));
  const HeaderValue origin = header(connection, MHD_HTTP_HEADER_ORIGIN);
  if (origin.count == 0) {
    return {};  // no page: browsers always say where a WebSocket or a request by a script comes from
  }
  const std::string from = lower_case(origin.value.value_or(""));
  const bool own = from == "http://" + host || from == "https://" + host;
  if (own || std::any_of(config.origins.begin(), config.origins.end(),
                         [&](const std::string& allowed) { return lower_case(allowed) == from; })) {
    return {};
  }
  return fmt::format("pages of '{}' may not use this (web.origins)", from.substr(0, 100));
}

MHD_Result WebServer::Impl::answer(MHD_Connection* connection, const std::string& path,
                                   std::string_view method) {
  connections.asked(connection);
  {
    const Lock lock(statistics_mutex);
    ++shown.requests;
  }
  if (const std::string why = stranger(connection); !why.empty()) {
    return refuse(connection, MHD_HTTP_FORBIDDEN, why);
  }
  if (method != MHD_HTTP_METHOD_GET && method != MHD_HTTP_METHOD_HEAD) {
    return refuse(connection, MHD_HTTP_METHOD_NOT_ALLOWED, "nothing here can be changed over HTTP");
  }
  if (method == MHD_HTTP_METHOD_GET && (path == "/stream" || path == "/control")) {
    return shake_hands(connection, path == "/stream" ? Door::Stream : Door::Look);
  }
  if (path == "/look") {
    return answer_look(connection);
  }
  if (const auto file = page.find(path); file != page.end()) {
    return send_page(connection, file->second);
  }
  if (MHD_Result refused = MHD_NO; !may_look(connection, refused)) {
    return refused;
  }
  constexpr std::string_view kTakes = "/takes/";
  if (path.rfind(kTakes, 0) == 0) {
    return send_file(connection, path.substr(kTakes.size()), kTakeFile);
  }
  constexpr std::string_view kSounds = "/sounds/";
  if (path.rfind(kSounds, 0) == 0) {
    return send_file(connection, path.substr(kSounds.size()), kSoundFile);
  }
  constexpr std::string_view kFrames = "/frames/";
  if (path.rfind(kFrames, 0) == 0) {
    return send_frames(connection, path.substr(kFrames.size()));
  }
  constexpr std::string_view kThumbnails = "/thumbnails/";
  if (path.rfind(kThumbnails, 0) == 0) {
    return send_thumbnail(connection, path.substr(kThumbnails.size()));
  }
  return refuse(connection, MHD_HTTP_NOT_FOUND,
                page.empty() ? "the page is not here: Facet was built without it (FACET_KIOSK)" : "not here");
}

MHD_Result WebServer::Impl::send_page(MHD_Connection* connection, const PageFile& file) const {
  // The library does not write to it, and the page lives as long as the server.
  const Response response(MHD_create_response_from_buffer(
      file.bytes.size(), const_cast<char*>(file.bytes.data()), MHD_RESPMEM_PERSISTENT));
  if (response == nullptr) {
    return MHD_NO;
  }
  for (const auto& [name, value] : kHeaders) {
    MHD_add_response_header(response.get(), name, value);
  }
  MHD_add_response_header(response.get(), MHD_HTTP_HEADER_CONTENT_TYPE, file.type);
  return send(connection, MHD_HTTP_OK, response);
}

MHD_Result WebServer::Impl::send_thumbnail(MHD_Connection* connection, const std::string& name) {
  constexpr std::size_t kMostBytes = 1U << 20;
  std::string bytes;
  try {
    const std::filesystem::path file = Thumbnails::file(takes, name);
    std::error_code ignored;
    if (!std::filesystem::is_regular_file(std::filesystem::symlink_status(file, ignored))) {
      return refuse(connection, MHD_HTTP_NOT_FOUND, "no picture of this take");
    }
    bytes = files::read_text(file, kMostBytes, "picture");
  } catch (const Error&) {
    return refuse(connection, MHD_HTTP_NOT_FOUND, "no picture of this take");
  }
  const Response response(MHD_create_response_from_buffer(bytes.size(), bytes.data(), MHD_RESPMEM_MUST_COPY));
  if (response == nullptr) {
    return MHD_NO;
  }
  for (const auto& [header_name, value] : kHeaders) {
    MHD_add_response_header(response.get(), header_name, value);
  }
  MHD_add_response_header(response.get(), MHD_HTTP_HEADER_CONTENT_TYPE, "image/png");
  return send(connection, MHD_HTTP_OK, response);
}

/// The files of a take that may be downloaded; none where the request was refused.
std::optional<TakeFiles> WebServer::Impl::closed_take(MHD_Connection* connection, const std::string& name,
                                                      MHD_Result& refused) {
  std::optional<TakeFiles> found = find_take(name);
  if (!found) {
    refused = refuse(connection, MHD_HTTP_NOT_FOUND, "no such take");
    return std::nullopt;
  }
  if (!found->obstacle.empty()) {
    refused = refuse(connection, MHD_HTTP_CONFLICT,
                     fmt::format("the take can't be downloaded now: {}", found->obstacle));
    return std::nullopt;
  }
  if (!connections.begin_download(connection)) {
    refused = refuse(connection, MHD_HTTP_SERVICE_UNAVAILABLE,
                     fmt::format("{} downloads are under way already; try again", config.max_downloads));
    return std::nullopt;
  }
  return found;
}

MHD_Result WebServer::Impl::send_frames(MHD_Connection* connection, const std::string& name) {
  MHD_Result refused = MHD_NO;
  const auto files = closed_take(connection, name, refused);
  if (!files) {
    return refused;
  }
  if (files->segments.empty()) {
    return refuse(connection, MHD_HTTP_NOT_FOUND, "the take has no pictures");
  }
  auto tar = std::make_unique<TarOfFiles>();
  for (const std::filesystem::path& segment : files->segments) {
    if (!tar->add(segment, segment.parent_path().filename().string())) {
      return refuse(connection, MHD_HTTP_CONFLICT, "a file of the take's pictures is missing");
    }
  }
  const auto read = [](void* archive, std::uint64_t position, char* out, std::size_t most) -> ssize_t {
    const ssize_t got = static_cast<TarOfFiles*>(archive)->read(position, out, most);
    return got < 0 ? MHD_CONTENT_READER_END_WITH_ERROR : got;
  };
  constexpr std::size_t kPiece = 256U << 10;
  const Response response(MHD_create_response_from_callback(
      tar->size(), kPiece, read, tar.get(), [](void* archive) { delete static_cast<TarOfFiles*>(archive); }));
  if (response == nullptr) {
    return MHD_NO;
  }
  static_cast<void>(tar.release());  // the response's own
  for (const auto& [header_name, value] : kHeaders) {
    MHD_add_response_header(response.get(), header_name, value);
  }
  MHD_add_response_header(response.get(), MHD_HTTP_HEADER_CONTENT_TYPE, "application/x-tar");
  MHD_add_response_header(
      response.get(), MHD_HTTP_HEADER_CONTENT_DISPOSITION,
      fmt::format("attachment; filename*=UTF-8''{}.frames.tar", percent_encoded(name)).c_str());
  return send(connection, MHD_HTTP_OK, response);
}

MHD_Result WebServer::Impl::send_file(MHD_Connection* connection, const std::string& name,
                                      const WholeFile& what) {
  MHD_Result refused = MHD_NO;
  const auto found = closed_take(connection, name, refused);
  if (!found) {
    return refused;
  }
  const std::filesystem::path file = what.is_sound ? take::sound_file_of(found->take) : found->take;
  const stream::FileDescriptor fd(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK));
  struct stat status {};
  if (!fd || ::fstat(fd.get(), &status) != 0 || !S_ISREG(status.st_mode)) {
    return refuse(connection, MHD_HTTP_NOT_FOUND, what.is_sound ? "the take has no sound" : "no such take");
  }
  const auto size = static_cast<std::uint64_t>(status.st_size);
  const std::string asked = header(connection, MHD_HTTP_HEADER_RANGE).value.value_or("");
  const ByteRange range = byte_range(asked, size);
  if (range.partial && range.first >= range.end) {
    return refuse(connection, MHD_HTTP_RANGE_NOT_SATISFIABLE, "the file is shorter");
  }
  const int passed = ::fcntl(fd.get(), F_DUPFD_CLOEXEC, 0);  // the response's own
  const Response response(
      MHD_create_response_from_fd_at_offset64(range.end - range.first, passed, range.first));
  if (response == nullptr) {
    ::close(passed);
    return MHD_NO;
  }
  for (const auto& [header_name, value] : kHeaders) {
    MHD_add_response_header(response.get(), header_name, value);
  }
  MHD_add_response_header(response.get(), MHD_HTTP_HEADER_CONTENT_TYPE, what.type);
  MHD_add_response_header(response.get(), MHD_HTTP_HEADER_ACCEPT_RANGES, "bytes");
  MHD_add_response_header(
      response.get(), MHD_HTTP_HEADER_CONTENT_DISPOSITION,
      fmt::format("attachment; filename*=UTF-8''{}.{}", percent_encoded(name), what.ending).c_str());
  if (range.partial) {
    MHD_add_response_header(response.get(), MHD_HTTP_HEADER_CONTENT_RANGE,
                            fmt::format("bytes {}-{}/{}", range.first, range.end - 1, size).c_str());
  }
  return send(connection, range.partial ? MHD_HTTP_PARTIAL_CONTENT : MHD_HTTP_OK, response);
}

/// The token of a request that is no handshake, where it shows one: "Bearer TOKEN", or what /look gave a
/// browser.
std::optional<std::string> WebServer::Impl::shown_token(MHD_Connection* connection) const {
  constexpr std::string_view kBearer = "Bearer ";
  const std::string given = header(connection, MHD_HTTP_HEADER_AUTHORIZATION).value.value_or("");
  if (given.rfind(kBearer, 0) == 0) {
    return given.substr(kBearer.size());
  }
  const char* kept = MHD_lookup_connection_value(connection, MHD_COOKIE_KIND, cookie.c_str());
  return kept != nullptr ? std::optional<std::string>(kept) : std::nullopt;
}

WebTokens::Opens WebServer::Impl::try_token(MHD_Connection* connection, std::string_view shown_one) {
  const WebTokens::Opens opens = tokens.opened_by(shown_one, peer_of(connection));
  if (opens == WebTokens::Opens::Nothing || opens == WebTokens::Opens::NothingNow) {
    const Lock lock(statistics_mutex);
    ++shown.wrong_tokens;
  }
  return opens;
}

MHD_Result WebServer::Impl::refuse_token(MHD_Connection* connection, WebTokens::Opens opens) {
  return opens == WebTokens::Opens::NothingNow
             ? refuse(connection, MHD_HTTP_TOO_MANY_REQUESTS, "too many wrong tokens; try again later")
             : refuse(connection, MHD_HTTP_UNAUTHORIZED,
                      "looking needs a token here (web.public): open the page with #token=TOKEN, or send "
                      "\"Authorization: Bearer TOKEN\"");
}

/// Whether whoever asks may look; else `refused` is the answer.
bool WebServer::Impl::may_look(MHD_Connection* connection, MHD_Result& refused) {
  if (!tokens.needed_to_look()) {
    return true;
  }
  const auto token = shown_token(connection);
  const WebTokens::Opens opens = token ? try_token(connection, *token) : WebTokens::Opens::Nothing;
  if (opens == WebTokens::Opens::Look || opens == WebTokens::Opens::Commands) {
    return true;
  }
  refused = refuse_token(connection, opens);
  return false;
}

/// Whether this browser may look: "open" where nobody needs a token for it, "look", or "commands" where it
/// shows the token for these. Where looking
/// needs a token it keeps it as a cookie that no script sees, so that pictures and downloads have it, too.
MHD_Result WebServer::Impl::answer_look(MHD_Connection* connection) {
  const auto token = shown_token(connection);
  const WebTokens::Opens opens = token                     ? try_token(connection, *token)
                                 : tokens.needed_to_look() ? WebTokens::Opens::Nothing
                                                           : WebTokens::Opens::Look;
  if (opens == WebTokens::Opens::Nothing || opens == WebTokens::Opens::NothingNow) {
    return refuse_token(connection, opens);
  }
  const Response response = words(opens == WebTokens::Opens::Commands ? "commands\n"
                                  : tokens.needed_to_look()           ? "look\n"
                                                                      : "open\n");
  if (token && tokens.needed_to_look()) {
    MHD_add_response_header(
        response.get(), MHD_HTTP_HEADER_SET_COOKIE,
        fmt::format("{}={}; Path=/; HttpOnly; SameSite=Strict; Max-Age=31536000", cookie, tokens.look())
            .c_str());
  }
  return send(connection, MHD_HTTP_OK, response);
}

/// What a handshake's token opens of /control; a stream is the same for whoever may look.
WebServer::Impl::Door WebServer::Impl::door_of_token(MHD_Connection* connection, Door asked,
                                                     std::string_view shown_one) {
  const WebTokens::Opens opens = try_token(connection, shown_one);
  switch (opens) {
    case WebTokens::Opens::Look:
      return asked;
    case WebTokens::Opens::Commands:
      return asked == Door::Look ? Door::Command : asked;
    case WebTokens::Opens::Nothing:
    case WebTokens::Opens::NothingNow:
      break;
  }
  const bool wrong = opens == WebTokens::Opens::Nothing;
  const Lock lock(statistics_mutex);
  ++shown.refused;
  shown.last_refusal = wrong ? "a wrong token was shown" : "too many wrong tokens were shown";
  return wrong ? Door::WrongToken : Door::TooManyTokens;
}

MHD_Result WebServer::Impl::shake_hands(MHD_Connection* connection, Door door) {
  const auto has = [&](const char* name, std::string_view wanted) {
    const std::string value = lower_case(header(connection, name).value.value_or(""));
    const auto listed = entries(value);
    return std::find(listed.begin(), listed.end(), wanted) != listed.end();
  };
  const std::string key = header(connection, MHD_HTTP_HEADER_SEC_WEBSOCKET_KEY).value.value_or("");
  if (!has(MHD_HTTP_HEADER_UPGRADE, "websocket") || !has(MHD_HTTP_HEADER_CONNECTION, "upgrade") ||
      !has(MHD_HTTP_HEADER_SEC_WEBSOCKET_VERSION, "13") || key.size() != 24) {
    return refuse(connection, MHD_HTTP_UPGRADE_REQUIRED, "this is a WebSocket, version 13");
  }
  const std::string protocols = header(connection, MHD_HTTP_HEADER_SEC_WEBSOCKET_PROTOCOL).value.value_or("");
  bool named = false;
  bool shown_one = false;
  for (const std::string_view protocol : entries(protocols)) {
    named = named || protocol == kProtocol;
    if (!shown_one && protocol.rfind(kTokenPrefix, 0) == 0 &&
        (door == Door::Look || tokens.needed_to_look())) {
      shown_one = true;
      door = door_of_token(connection, door, protocol.substr(kTokenPrefix.size()));
    }
  }
  if (MHD_Result refused = MHD_NO; !shown_one && !may_look(connection, refused)) {
    return refused;
  }
  const Response response(
      MHD_create_response_for_upgrade(&Impl::on_upgrade, &passages.at(static_cast<std::size_t>(door))));
  if (response == nullptr) {
    return MHD_NO;
  }
  MHD_add_response_header(response.get(), MHD_HTTP_HEADER_UPGRADE, "websocket");
  MHD_add_response_header(response.get(), MHD_HTTP_HEADER_SEC_WEBSOCKET_ACCEPT,
                          stream::web_socket_accept(key).c_str());
  if (named) {
    MHD_add_response_header(response.get(), MHD_HTTP_HEADER_SEC_WEBSOCKET_PROTOCOL,
                            std::string(kProtocol).c_str());
  }
  return send(connection, MHD_HTTP_SWITCHING_PROTOCOLS, response);
}

void WebServer::Impl::on_upgrade(void* passage, MHD_Connection* connection, void* /*state*/,
                                 const char* early, std::size_t early_size, MHD_socket socket,
                                 MHD_UpgradeResponseHandle* handle) {
  const auto& through = *static_cast<const Passage*>(passage);
  through.impl->connections.handed_over(connection);
  // A descriptor of our own: libmicrohttpd closes its own with the handle and needs no more of the
  // connection.
  stream::FileDescriptor own(::fcntl(socket, F_DUPFD_CLOEXEC, 0));
  try {
    if (own) {
      const auto* const bytes = reinterpret_cast<const std::uint8_t*>(early);
      through.impl->hand_over(through.door, std::move(own), {bytes, bytes + early_size});
    }
  } catch (const std::exception&) {
    // No memory for one more client: it is closed.
  }
  MHD_upgrade_action(handle, MHD_UPGRADE_ACTION_CLOSE);
}

void WebServer::Impl::hand_over(Door door, stream::FileDescriptor connection,
                                std::vector<std::uint8_t> early) {
  const int yes = 1;
  const int fd = connection.get();
  ::fcntl(fd, F_SETFL, ::fcntl(fd, F_GETFL) | O_NONBLOCK);
  ::setsockopt(fd, SOL_SOCKET, SO_SNDBUF, &kSendBufferBytes, sizeof(kSendBufferBytes));
  ::setsockopt(fd, SOL_SOCKET, SO_KEEPALIVE, &yes, sizeof(yes));
  ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof(yes));
  ::setsockopt(fd, IPPROTO_TCP, TCP_USER_TIMEOUT, &kSilence_ms, sizeof(kSilence_ms));
  switch (door) {
    case Door::Stream:
      stream.adopt(std::move(connection), std::move(early));
      return;
    case Door::Look:
    case Door::Command:
      control.adopt(std::move(connection), {0, 0, door == Door::Command, true}, stream::peer_address(fd),
                    std::move(early));
      return;
    case Door::WrongToken:
    case Door::TooManyTokens:
    case Door::Count: {
      const bool wrong = door == Door::WrongToken;
      const auto frame = stream::web_socket_close(
          wrong ? stream::WebSocketClose::WrongToken : stream::WebSocketClose::TooManyTokens,
          wrong ? "wrong token" : "too many wrong tokens; try again later");
      [[maybe_unused]] const ssize_t ignored =
          ::send(fd, frame.data(), frame.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
      return;
    }
  }
}

WebServer::WebServer(const WebConfig& config, std::filesystem::path takes, FindTake find_take,
                     stream::StreamServer& stream, ControlServer& control)
    : impl_(std::make_unique<Impl>(config, std::move(takes), std::move(find_take), stream, control)) {
  impl_->server = start_http(config.listen, impl_->connections, impl_->on_request, "web.listen", "the page",
                             MHD_ALLOW_UPGRADE);
}

WebServer::~WebServer() = default;

int WebServer::port() const {
  return port_of(impl_->server);
}

std::string WebServer::url() const {
  const std::string& listen = impl_->config.listen;
  return fmt::format("http://{}:{}/", listen.substr(0, listen.rfind(':')), port());
}

const std::string& WebServer::token_fault() const {
  return impl_->tokens.fault();
}

bool WebServer::has_page() const {
  return !impl_->page.empty();
}

WebStatistics WebServer::statistics() const {
  WebStatistics now;
  {
    const Lock lock(impl_->statistics_mutex);
    now = impl_->shown;
  }
  now.broken_off = impl_->connections.broken_off();
  return now;
}

void WebServer::look_after(Clock::time_point now) {
  impl_->connections.look_after(now);
}

std::optional<TakeFiles> find_take(const std::filesystem::path& folder, const std::string& name) {
  TakeFiles found;
  try {
    found.take = take::named_take(folder, name);
  } catch (const Error&) {
    return std::nullopt;
  }
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(std::filesystem::symlink_status(found.take, ignored))) {
    return std::nullopt;
  }
  try {
    // Whoever holds the file locked is not waited for; the reader of takes would.
    take::Database(found.take, take::Database::Mode::ReadOnly).query_int64("SELECT count(*) FROM meta");
    const take::TakeInfo info = take::TakeReader(found.take).info();
    if (!info.closed) {
      found.obstacle = "it is not closed";
    } else if (take::log_bytes(found.take) > 0) {
      found.obstacle = "a part of it is still in the -wal file beside it, as another program reads it";
    }
    std::transform(info.segments.begin(), info.segments.end(), std::back_inserter(found.segments),
                   [](const take::TakeSegment& segment) { return segment.file; });
  } catch (const take::DatabaseError&) {
    found.obstacle = "it can't be read now, or another program holds it";
  } catch (const Error&) {
    found.obstacle = "it can't be read";
  }
  return found;
}

}  // namespace facet::service
