#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "solver_problem.hpp"

namespace facet::bench {

/// What the hand-vectorised solver did.
struct VectorResult {
  std::vector<float> displacements_mm;  ///< [vertex_count]
  double step_ms = 0;                   ///< mean of a Gauss-Newton step
};

/// The Gauss-Newton step of [MD19 eq. 7, 8] written for a CPU's vector units, as the yardstick of the GPU
/// path: eight vertices at a time in chunks of like valence (sliced ELL), float, all three channels folded
/// into one residual (they follow the normal through l . SH(n) alone), a transposed copy of J for J^T y, one
/// thread for each core.
class VectorSolver {
 public:
  VectorSolver(const SolverProblem& problem, int threads);

  VectorResult solve(int steps, int pcg_iterations);

 private:
  static constexpr std::size_t lanes = 8;
  using Floats = std::vector<float>;
  using Indices = std::vector<std::int32_t>;

  struct Chunks {
    std::size_t begin;
    std::size_t end;
  };
  /// One thread's part of the sums, on cache lines of its own.
  struct alignas(64) Partial {
    double value = 0;
  };
  class Crew;

  void order_vertices(const mesh::OneRings& rings);
  void build_rings(const mesh::OneRings& rings);
  void load_vertices(const SolverProblem& problem);

  void run(Crew& crew, int thread, int steps, int pcg_iterations);
  void linearise(Chunks chunks);
  double start_search(Chunks chunks);
  double products(Chunks chunks);
  double descend(Chunks chunks, float alpha);
  void next_direction(Chunks chunks, float beta);
  void move(Chunks chunks);

  int threads_;
  std::size_t chunk_count_ = 0;
  std::size_t padded_ = 0;  ///< vertices in chunks; index padded_ is a vertex of zeros
  Indices vertex_of_;       ///< [padded] original index, or -1
  Indices slot_of_;         ///< [vertex_count] its place in the chunks

  // Rings by chunk: entry (k, lane) of chunk c is at 8 * (row_begin_[c] + k) + lane.
  std::vector<std::size_t> row_begin_;  ///< [chunk_count + 1]
  Indices ring_;                        ///< neighbours; padded_ behind the ring's end
  Indices closed_ring_;                 ///< neighbours; the first one again behind the ring's end
  Indices last_;                        ///< [padded] the last neighbour
  Indices mirror_;                      ///< where the neighbour keeps its entry for this vertex
  Floats jacobian_;                     ///< d e_i / d d of the neighbours, one zero at the end
  Floats transposed_;                   ///< d e of the neighbours / d d_i

  Floats x_, y_, z_, nx_, ny_, nz_;  // vertices and unit coarse normals
  Floats red_, green_, blue_;        // I
  Floats albedo_red_, albedo_green_, albedo_blue_;
  Floats weight_, free_, valence_, prolonged_;  // data weight times gain; 1 where d may move
  Floats bend_;                                 // sqrt(w3) / spacing / valence
  Floats prior_, hierarchy_;                    // w4 / spacing^2 + w5; w4 / spacing^2
  Floats smooth_diagonal_;
  Floats start_, d_;
  Floats residual_, bent_, product_;  // e or J p; (L d)_i or (L p)_i times bend_
  Floats inverse_diagonal_, gradient_, search_, update_;
  std::array<float, 9> lighting_;
};

}  // namespace facet::bench
