#pragma once

#include <cerrno>
#include <string>
#include <system_error>

#include "facet/error.hpp"

namespace facet {

/// Whether a failed system call may succeed when it is tried again: what the machine is short of now
/// (descriptors, memory, threads), a disk that did not answer this once, what another process holds for a
/// moment.
inline bool may_pass(int error) {
  switch (error) {
    case EAGAIN:
    case EBUSY:
    case EINTR:
    case EIO:
    case EMFILE:
    case ENFILE:
    case ENOBUFS:
    case ENOMEM:
    case ESTALE:
    case ETIMEDOUT:
      return true;
    default:
      return false;
  }
}

/// The kind of a failed system call: Unavailable, which whoever supervises the process answers by trying
/// again, where it may pass; else `lasting`, which is what the failure means otherwise.
///
/// error   an errno, positive
inline ErrorKind kind_of_errno(int error, ErrorKind lasting = ErrorKind::UnreadableInput) {
  return may_pass(error) ? ErrorKind::Unavailable : lasting;
}

/// What happened, for people, with "another try may help" where it may.
inline std::string describe_errno(int error) {
  return std::generic_category().message(error) + (may_pass(error) ? " (another try may help)" : "");
}

}  // namespace facet
