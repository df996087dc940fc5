#include "person/person_folder.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <nlohmann/json.hpp>
#include <system_error>

#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"

namespace facet::person {
namespace {

constexpr const char* kExtension = ".person";
constexpr std::size_t kMostNameBytes = 64;  // as a name on the stream

/// JSON texts are UTF-8: what the file could not hold is none.
bool is_utf8(const std::string& text) {
  try {
    (void)nlohmann::json(text).dump();
    return true;
  } catch (const nlohmann::json::exception&) {
    return false;
  }
}

[[noreturn]] void refuse_without_folder(const std::string& name) {
  throw Error(ErrorKind::Usage,
              fmt::format("'{}' is a name, and persons are found by name only where a folder of them is "
                          "configured ([persons] folder): set it, or name the file",
                          name));
}

/// "it knows ada, grace", for messages.
std::string who_is_known(const std::vector<StoredPerson>& persons) {
  std::vector<std::string> names;
  for (const StoredPerson& stored : persons) {
    names.push_back(stored.fault.empty() ? stored.name() : stored.name() + " (unreadable)");
  }
  return names.empty() ? "nobody is stored there" : fmt::format("stored there: {}", fmt::join(names, ", "));
}

}  // namespace

bool is_person_path(std::string_view given) {
  return given.find('/') != std::string_view::npos || given.ends_with(kExtension);
}

void check_person_name(const std::string& name) {
  const bool bad_character = std::any_of(name.begin(), name.end(), [](char character) {
    const auto code = static_cast<unsigned char>(character);
    return character == '/' || code < 0x20 || code == 0x7F;
  });
  if (name.empty() || name.size() > kMostNameBytes || name.front() == '.' || bad_character ||
      name == kRecognised || is_person_path(name) || !is_utf8(name)) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' is no name for a person: 1 to {} bytes of UTF-8, no slash, no control "
                            "character, not beginning with a dot, not ending in {}, and not \"{}\"",
                            name, kMostNameBytes, kExtension, kRecognised));
  }
}

std::vector<StoredPerson> stored_persons(const std::filesystem::path& folder) {
  std::vector<StoredPerson> persons;
  std::error_code error;
  std::filesystem::directory_iterator entry(folder, error);
  for (; !error && entry != std::filesystem::directory_iterator(); entry.increment(error)) {
    if (entry->path().extension() != kExtension) {
      continue;
    }
    StoredPerson stored{entry->path(), {}, ""};
    try {
      stored.person = read_person(stored.file);
    } catch (const Error& fault) {
      stored.fault = fault.what();
    }
    persons.push_back(std::move(stored));
  }
  if (error) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("folder of persons '{}': {}", folder.string(), error.message()));
  }
  std::sort(persons.begin(), persons.end(), [](const StoredPerson& a, const StoredPerson& b) {
    return std::pair(a.name(), a.file) < std::pair(b.name(), b.file);
  });
  return persons;
}

std::filesystem::path new_person_file(const std::filesystem::path& folder, const std::string& name) {
  check_person_name(name);
  if (folder.empty()) {
    refuse_without_folder(name);
  }
  std::error_code ignored;
  if (!std::filesystem::is_directory(folder, ignored)) {
    throw Error(ErrorKind::Storage, fmt::format("folder of persons '{}' is not there: make it, for its owner "
                                                "alone (mkdir -m 700), or configure another",
                                                folder.string()));
  }
  if (::faccessat(AT_FDCWD, folder.c_str(), W_OK | X_OK, AT_EACCESS) != 0) {
    throw Error(ErrorKind::Storage, fmt::format("folder of persons '{}' can't be written to: {}",
                                                folder.string(), std::system_category().message(errno)));
  }
  for (const StoredPerson& stored : stored_persons(folder)) {
    if (stored.name() == name || stored.file.stem() == name) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("somebody is called '{}' already ({}): give another name, or delete that person", name,
                      stored.file.string()));
    }
  }
  return folder / (name + kExtension);
}

std::filesystem::path person_file(const std::string& given, const std::filesystem::path& folder) {
  if (is_person_path(given)) {
    return given;
  }
  check_person_name(given);
  if (folder.empty()) {
    refuse_without_folder(given);
  }
  const std::vector<StoredPerson> persons = stored_persons(folder);
  std::vector<std::string> found;
  for (const StoredPerson& stored : persons) {
    if (stored.name() == given || stored.file.stem() == given) {
      found.push_back(stored.file.string());
    }
  }
  if (found.empty()) {
    throw Error(ErrorKind::Usage, fmt::format("nobody is called '{}' in '{}'; {}", given, folder.string(),
                                              who_is_known(persons)));
  }
  if (found.size() > 1) {
    throw Error(ErrorKind::Usage, fmt::format("{} persons are called '{}': name the file, one of {}",
                                              found.size(), given, fmt::join(found, ", ")));
  }
  return found.front();
}

void delete_person(const std::filesystem::path& file) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::symlink_status(file, error);
  if (!std::filesystem::exists(status)) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("'{}' is not there", file.string()));
  }
  if (!std::filesystem::is_regular_file(status)) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' is a link or a folder, not a person's file: nothing is deleted; name the "
                            "file itself",
                            file.string()));
  }
  if (!begins_as_person(file)) {
    throw Error(ErrorKind::Usage, fmt::format("'{}' is no person's file: nothing is deleted", file.string()));
  }
  if (!std::filesystem::remove(file, error) || error) {
    throw Error(ErrorKind::Storage, fmt::format("'{}' can't be deleted: {}", file.string(), error.message()));
  }
  files::sync_folder(file.parent_path());
}

}  // namespace facet::person
