#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "service/log.hpp"
#include "service/thumbnails.hpp"

namespace facet::service {

/// What the takes of a folder say of themselves. A take is read when it is new or was changed, and
/// remembered: looking again costs a glance at the folder, whatever the takes hold. Any thread; every method
/// but number() and stale() blocks on the disk, so none of them is for the daemon's loop.
class TakeIndex {
 public:
  /// thumbnails: asked for the pictures of what is listed.
  TakeIndex(std::filesystem::path folder, Thumbnails& thumbnails);
  ~TakeIndex();
  TakeIndex(const TakeIndex&) = delete;
  TakeIndex& operator=(const TakeIndex&) = delete;

  /// The answer of "takes.list" (docs/control-protocol.md) as JSON: newest first, and what each says of
  /// itself; a file that is no take, or whose name no method takes, has "error" instead. At most kMostListed
  /// are looked into; "count" tells all. Looks anew, but where that has just been done: then not before
  /// changed() or ten times what looking took, so that nobody who asks without end keeps the disk busy.
  /// Throws Error(Storage) where the folder can't be read.
  std::string list();
  /// The same for those who only want to know whether the list is another one: no pictures are made of takes
  /// before somebody has asked for the list.
  void look();
  /// What was listed is not as it was: the next list() looks anew.
  void changed();
  /// Nobody has looked since changed(). Any thread, never blocks.
  bool stale() const;
  /// Differs from before when the list does. Any thread, never blocks; 0: nothing was listed yet.
  std::uint64_t number() const;

  /// Files that were opened so far to read what they say. Any thread.
  std::uint64_t reads() const;

  /// Closes what recorders that were killed left behind (take::close_take), and logs it; a take that anyone
  /// has open stays as it is. Only takes that have a log beside them, or are listed as not closed, are looked
  /// into.
  void close_broken_off(const Log& log, const std::function<bool()>& go_on);

  static constexpr std::size_t kMostListed = 200;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::service
