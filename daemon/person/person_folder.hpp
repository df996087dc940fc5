#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "person/person_file.hpp"

namespace facet::person {

/// A file of the folder of persons.
struct StoredPerson {
  std::filesystem::path file;
  PersonFile person;
  std::string fault;  ///< why it can't be read, naming the file; empty: `person` is what it holds

  /// What it is called: by what it says itself; a file that can't be read by its own name.
  std::string name() const { return fault.empty() ? person.name : file.stem().string(); }
};

/// Whether a text names a file rather than a person: it has a slash or ends in ".person".
bool is_person_path(std::string_view given);

/// Throws Error(Usage) where nobody can be called so: 1 to 64 bytes of UTF-8, no slash, no control character,
/// not beginning with a dot, not "auto" and nothing that is_person_path.
void check_person_name(const std::string& name);

/// Every NAME.person of a folder, by name. Bad files are among them, with their faults. Throws
/// Error(UnreadableInput) where there is no such folder or it can't be read.
std::vector<StoredPerson> stored_persons(const std::filesystem::path& folder);

/// FOLDER/NAME.person of somebody who is to be stored. Throws Error(Usage) where no folder is given
/// (`folder` empty), nobody can be called so, or somebody is already; Error(Storage) where there is no such
/// folder or it can't be written to.
std::filesystem::path new_person_file(const std::filesystem::path& folder, const std::string& name);

/// The file of a person who is named, by what is_person_path or by what the folder's files and persons are
/// called. Throws Error(Usage) that lists who is known where nobody or more than one is called so, and where
/// no folder is given (`folder` empty).
std::filesystem::path person_file(const std::string& given, const std::filesystem::path& folder);

/// Removes a person's file, be it damaged or not, for good: it is off the disk's index when this returns.
/// Throws Error(Usage) where it is no person's file (nothing is removed then) and Error(Storage) where it
/// can't be removed.
void delete_person(const std::filesystem::path& file);

}  // namespace facet::person
