#pragma once

#include <array>

#include "mesh/mesh_frame.hpp"

namespace facet::tools {

struct Stage {
  const char* name;  ///< for people
  float mesh::StageTimes::*time_ms;
};

/// What a frame spends its time with, in order; the last is the whole.
constexpr std::array kStages = {
    Stage{"capture (decode)", &mesh::StageTimes::capture_ms},
    Stage{"face detector", &mesh::StageTimes::detect_ms},
    Stage{"landmark net", &mesh::StageTimes::landmarks_ms},
    Stage{"coarse fit", &mesh::StageTimes::fit_ms},
    Stage{"upload, pyramid", &mesh::StageTimes::upload_ms},
    Stage{"lighting (eq. 3)", &mesh::StageTimes::lighting_ms},
    Stage{"albedo (eq. 4)", &mesh::StageTimes::albedo_ms},
    Stage{"displacement (eq. 6)", &mesh::StageTimes::displacement_ms},
    Stage{"read-back", &mesh::StageTimes::readback_ms},
    Stage{"depth maps", &mesh::StageTimes::depth_ms},
    Stage{"latency, frame to mesh", &mesh::StageTimes::latency_ms},
};

}  // namespace facet::tools
