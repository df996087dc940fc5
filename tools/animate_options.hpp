#pragma once

#include <memory>
#include <string>
#include <vector>

#include "animate/take_basis.hpp"
#include "mesh/mesh_frame.hpp"
#include "options.hpp"
#include "render/renderer.hpp"

namespace facet::tools {

class StopSignals;

/// Options of the commands that edit or animate a take.
struct BasisChoice {
  std::string take;
  int coarse_rank = animate::BasisOptions{}.coarse_rank;
  int detail_rank = animate::BasisOptions{}.detail_rank;
  std::string file;
};

/// Adds TAKE, --coarse-rank, --detail-rank and --basis.
void add_basis_options(Command command, BasisChoice& choice);

/// Opens or makes the basis with a progress line, and prints what it holds. A signal breaks it off: ends the
/// process.
std::shared_ptr<const animate::TakeBasis> open_basis(const BasisChoice& choice, const StopSignals& signals);

/// Ends the process, with a sentence, where a signal has come.
void end_where_broken_off(const StopSignals& signals, const std::string& output);

/// "1,2.5,-3": exactly `count` finite numbers. Throws Error(Usage) naming the option.
std::vector<float> parse_numbers(const std::string& option, const std::string& text, std::size_t count);

/// A posed face in grey light.
/// tints [3][finest vertex_count] linear RGB, what the grey is multiplied by; empty: nothing
render::Picture draw_face(const mesh::MeshFrame& frame, const CameraIntrinsics& camera,
                          const mesh::Vertices& tints = {});

}  // namespace facet::tools
