#pragma once

#include <filesystem>
#include <functional>

#include "pipeline/status.hpp"
#include "service/control_protocol.hpp"
#include "service/errands.hpp"
#include "service/log.hpp"

namespace facet::service {

/// The persons' part of the control protocol: person.* (docs/control-protocol.md). now: the pipeline's
/// status, burst: pipeline::Pipeline::burst, both called on the loop. folder: of persons; empty: nobody is
/// kept. Borrows the errands, which wait for the disk, and the log.
ControlMethods person_methods(std::function<pipeline::PipelineStatus()> now, std::function<void()> burst,
                              const std::filesystem::path& folder, Errands& errands, const Log& log);

}  // namespace facet::service
