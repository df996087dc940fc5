#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>

struct sqlite3;
struct sqlite3_stmt;

/// A thin owner's layer over SQLite for this room.
namespace facet::take {

/// What SQLite reports; the room turns it into facet::Error with the file's name.
class DatabaseError : public std::runtime_error {
 public:
  DatabaseError(int code, const std::string& message) : std::runtime_error(message), code_(code) {}
  int code() const { return code_; }  ///< primary SQLite result code

 private:
  int code_;
};

class Database;

/// A prepared statement. bind_* count parameters from 1, column_* count columns from 0. Throws DatabaseError.
class Statement {
 public:
  Statement(Database& database, std::string_view sql);

  void bind(int parameter, std::int64_t value);
  void bind(int parameter, std::string_view text);
  void bind(int parameter, std::span<const std::uint8_t> blob);  ///< must live until the statement has run

  /// True where a row is there. A statement at its end is reset and may be bound and run again.
  bool step();
  /// Runs a statement that gives no rows.
  void run();
  void reset();

  std::int64_t column_int64(int column);
  std::string column_text(int column);
  std::span<const std::uint8_t> column_blob(int column);  ///< valid until the next step or reset
  bool column_is_null(int column);

 private:
  struct Finalize {
    void operator()(sqlite3_stmt* statement) const;
  };
  Database* database_;
  std::unique_ptr<sqlite3_stmt, Finalize> statement_;
};

/// One connection. Throws DatabaseError.
class Database {
 public:
  /// None creates the file. Immutable: nobody can change it, a log beside it is not looked at.
  enum class Mode { ReadOnly, ReadWrite, Immutable };
  Database(const std::filesystem::path& file, Mode mode);

  void execute(const std::string& sql);  ///< statements without parameters; rows are ignored
  std::int64_t query_int64(const std::string& sql);
  bool in_transaction() const;
  /// A longer text or blob is not read: SQLITE_TOOBIG instead. At first as long as a take's blobs may be.
  void set_longest_value(std::size_t bytes);
  void set_busy_timeout_ms(int timeout_ms);
  /// Begins a write-ahead log, or folds it into the file and leaves its mode: the file alone is the database.
  /// False, with nothing changed, where another connection of any process was in the way all the time.
  bool begin_log(std::chrono::milliseconds patience) { return set_journal_mode("WAL", patience); }
  bool end_log(std::chrono::milliseconds patience);
  /// The log stays where it is when the connection closes: what is in it may be nowhere else.
  void keep_log();
  /// Waits until the file is on the disk.
  void sync();
  sqlite3* handle() const { return handle_.get(); }

 private:
  bool set_journal_mode(const std::string& mode, std::chrono::milliseconds patience);
  struct Close {
    void operator()(sqlite3* handle) const;
  };
  std::unique_ptr<sqlite3, Close> handle_;
};

/// Bytes of the write-ahead log beside a file; 0 where there is none.
std::uint64_t log_bytes(const std::filesystem::path& file);

}  // namespace facet::take
