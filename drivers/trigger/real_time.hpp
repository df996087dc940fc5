#pragma once

#include <string>

namespace facet::trigger {

struct RealTime {
  bool granted = false;     ///< SCHED_FIFO and locked memory, both
  std::string description;  ///< for people: what was granted, and what right is missing
};

/// Gives the calling thread SCHED_FIFO with this priority and locks the process's memory, as far as it may.
/// Memory is locked as it is touched, and only where no limit on locked memory could make a later allocation
/// fail. Not undone.
RealTime become_real_time(int priority);

}  // namespace facet::trigger
