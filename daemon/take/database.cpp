#include "take/database.hpp"

#include <fmt/format.h>
#include <sqlite3.h>

#include <system_error>
#include <thread>

#include "take/take_file.hpp"

namespace facet::take {
namespace {

constexpr int kPrimaryCodeMask = 0xFF;

[[noreturn]] void fail(sqlite3* handle, int code) {
  throw DatabaseError(code & kPrimaryCodeMask,
                      handle != nullptr ? sqlite3_errmsg(handle) : sqlite3_errstr(code));
}

void check(sqlite3* handle, int code) {
  if (code != SQLITE_OK) {
    fail(handle, code);
  }
}

/// The URI of a file that nobody changes, https://www.sqlite.org/uri.html.
std::string immutable_uri(const std::filesystem::path& file) {
  std::string uri = "file://";
  for (const char character : std::filesystem::absolute(file).string()) {
    if (character == '%' || character == '?' || character == '#') {
      uri += fmt::format("%{:02X}", static_cast<unsigned>(character));
    } else {
      uri += character;
    }
  }
  return uri + "?immutable=1";
}

}  // namespace

void Statement::Finalize::operator()(sqlite3_stmt* statement) const {
  sqlite3_finalize(statement);
}

void Database::Close::operator()(sqlite3* handle) const {
  sqlite3_close_v2(handle);
}

Statement::Statement(Database& database, std::string_view sql) : database_(&database) {
  sqlite3_stmt* statement = nullptr;
  const int code = sqlite3_prepare_v3(database.handle(), sql.data(), static_cast<int>(sql.size()),
                                      SQLITE_PREPARE_PERSISTENT, &statement, nullptr);
  statement_.reset(statement);
  check(database.handle(), code);
}

void Statement::bind(int parameter, std::int64_t value) {
  check(database_->handle(), sqlite3_bind_int64(statement_.get(), parameter, value));
}

void Statement::bind(int parameter, std::string_view text) {
  check(database_->handle(), sqlite3_bind_text64(statement_.get(), parameter, text.data(), text.size(),
                                                 SQLITE_TRANSIENT, SQLITE_UTF8));
}

void Statement::bind(int parameter, std::span<const std::uint8_t> blob) {
  check(database_->handle(),
        sqlite3_bind_blob64(statement_.get(), parameter, blob.data(), blob.size(), SQLITE_STATIC));
}

bool Statement::step() {
  const int code = sqlite3_step(statement_.get());
  if (code == SQLITE_ROW) {
    return true;
  }
  if (code != SQLITE_DONE) {
    // The message must be read before the reset, the reset must come before the statement's next use.
    const DatabaseError error(code & kPrimaryCodeMask, sqlite3_errmsg(database_->handle()));
    sqlite3_reset(statement_.get());
    throw error;
  }
  sqlite3_reset(statement_.get());
  return false;
}

void Statement::run() {
  while (step()) {
  }
}

void Statement::reset() {
  sqlite3_reset(statement_.get());
}

std::int64_t Statement::column_int64(int column) {
  return sqlite3_column_int64(statement_.get(), column);
}

std::string Statement::column_text(int column) {
  const auto* text = sqlite3_column_text(statement_.get(), column);
  const auto size = static_cast<std::size_t>(sqlite3_column_bytes(statement_.get(), column));
  return text != nullptr ? std::string(reinterpret_cast<const char*>(text), size) : std::string();
}

std::span<const std::uint8_t> Statement::column_blob(int column) {
  const auto* data = static_cast<const std::uint8_t*>(sqlite3_column_blob(statement_.get(), column));
  return {data,
          data != nullptr ? static_cast<std::size_t>(sqlite3_column_bytes(statement_.get(), column)) : 0};
}

bool Statement::column_is_null(int column) {
  return sqlite3_column_type(statement_.get(), column) == SQLITE_NULL;
}

Database::Database(const std::filesystem::path& file, Mode mode) {
  sqlite3* handle = nullptr;
  const bool immutable = mode == Mode::Immutable;
  const int flags = (mode == Mode::ReadWrite ? SQLITE_OPEN_READWRITE : SQLITE_OPEN_READONLY) |
                    (immutable ? SQLITE_OPEN_URI : 0) | SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_PRIVATECACHE;
  const std::string name = immutable ? immutable_uri(file) : file.string();
  const int code = sqlite3_open_v2(name.c_str(), &handle, flags, nullptr);
  handle_.reset(handle);
  check(handle, code);
  // A take from elsewhere is data: nothing in its schema may run code or make SQLite take endless memory.
  sqlite3_db_config(handle, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  sqlite3_db_config(handle, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  set_longest_value(kMaxStoredBytes);
}

void Database::execute(const std::string& sql) {
  check(handle_.get(), sqlite3_exec(handle_.get(), sql.c_str(), nullptr, nullptr, nullptr));
}

std::int64_t Database::query_int64(const std::string& sql) {
  Statement statement(*this, sql);
  return statement.step() ? statement.column_int64(0) : 0;
}

bool Database::in_transaction() const {
  return sqlite3_get_autocommit(handle_.get()) == 0;
}

void Database::set_longest_value(std::size_t bytes) {
  sqlite3_limit(handle_.get(), SQLITE_LIMIT_LENGTH, static_cast<int>(bytes));
}

void Database::set_busy_timeout_ms(int timeout_ms) {
  sqlite3_busy_timeout(handle_.get(), timeout_ms);
}

bool Database::set_journal_mode(const std::string& mode, std::chrono::milliseconds patience) {
  constexpr auto kPause = std::chrono::milliseconds(10);  // SQLite's own busy timeout does not hold here
  for (auto left = patience; left > left.zero(); left -= kPause) {
    try {
      execute("PRAGMA journal_mode = " + mode);
      return true;
    } catch (const DatabaseError& error) {
      if (error.code() != SQLITE_BUSY && error.code() != SQLITE_LOCKED) {
        throw;
      }
    }
    std::this_thread::sleep_for(kPause);
  }
  return false;
}

bool Database::end_log(std::chrono::milliseconds patience) {
  // All that changes behind the log is two bytes in the file's first sector, which is written whole or not at
  // all: a journal on the disk would only cost three more syncs and a descriptor.
  if (!set_journal_mode("MEMORY", patience)) {
    return false;
  }
  execute("PRAGMA journal_mode = DELETE");
  return true;
}

void Database::keep_log() {
  sqlite3_db_config(handle_.get(), SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1, nullptr);
}

void Database::sync() {
  // By SQLite's own descriptor: another one of ours, closed, would take all its locks of the file away.
  sqlite3_file* file = nullptr;
  check(handle_.get(), sqlite3_file_control(handle_.get(), "main", SQLITE_FCNTL_FILE_POINTER, &file));
  if (const int code = file->pMethods->xSync(file, SQLITE_SYNC_NORMAL); code != SQLITE_OK) {
    throw DatabaseError(code & kPrimaryCodeMask, sqlite3_errstr(code));
  }
}

std::uint64_t log_bytes(const std::filesystem::path& file) {
  std::error_code error;
  // SQLite puts the log beside the file itself, not beside a link to it.
  const std::uintmax_t bytes =
      std::filesystem::file_size(std::filesystem::weakly_canonical(file, error).string() + "-wal", error);
  return error ? 0 : bytes;
}

}  // namespace facet::take
