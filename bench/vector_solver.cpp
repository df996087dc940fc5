#include "vector_solver.hpp"

#include <algorithm>
#include <barrier>
#include <chrono>
#include <cmath>
#include <numeric>
#include <thread>

#ifdef __AVX2__
#include <immintrin.h>
#endif

namespace facet::bench {
namespace {

using Vector = float __attribute__((vector_size(32)));
using Mask = std::int32_t __attribute__((vector_size(32)));

// Vertices are sorted by valence within windows of this many: chunks of one valence, and neighbours stay
// near.
constexpr std::size_t sorting_window = 256;

Vector load(const std::vector<float>& values, std::size_t at) {
  Vector out;
  __builtin_memcpy(&out, values.data() + at, sizeof(out));
  return out;
}

void store(std::vector<float>& values, std::size_t at, Vector vector) {
  __builtin_memcpy(values.data() + at, &vector, sizeof(vector));
}

Vector gather(const std::vector<float>& values, const std::vector<std::int32_t>& indices, std::size_t at) {
#ifdef __AVX2__
  const __m256i index = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(indices.data() + at));
  return _mm256_i32gather_ps(values.data(), index, sizeof(float));
#else
  Vector out;
  for (std::size_t lane = 0; lane < 8; ++lane) {
    out[lane] = values[static_cast<std::size_t>(indices[at + lane])];
  }
  return out;
#endif
}

Vector square_root(Vector value) {
#ifdef __AVX2__
  return _mm256_sqrt_ps(value);
#else
  for (int lane = 0; lane < 8; ++lane) {
    value[lane] = std::sqrt(value[lane]);
  }
  return value;
#endif
}

Vector where(Mask mask, Vector value) {
  Mask bits;
  __builtin_memcpy(&bits, &value, sizeof(bits));
  bits &= mask;
  __builtin_memcpy(&value, &bits, sizeof(bits));
  return value;
}

double sum(Vector value) {
  double out = 0;
  for (int lane = 0; lane < 8; ++lane) {
    out += static_cast<double>(value[lane]);
  }
  return out;
}

struct Vector3 {
  Vector x, y, z;
};

Vector3 operator-(const Vector3& a, const Vector3& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}

Vector3 cross(const Vector3& a, const Vector3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

Vector dot(const Vector3& a, const Vector3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

}  // namespace

/// The threads of one solve: meeting points and sums over all of them.
class VectorSolver::Crew {
 public:
  explicit Crew(int size)
      : barrier_(size),
        partials_{std::vector<Partial>(static_cast<std::size_t>(size)),
                  std::vector<Partial>(static_cast<std::size_t>(size))} {}

  void meet() { barrier_.arrive_and_wait(); }

  /// The sum over all threads' values; also a meeting point. Two sets in turn, so that a fast thread's next
  /// value does not overwrite one that is still being read.
  double sum(int thread, int turn, double value) {
    std::vector<Partial>& partials = partials_[static_cast<std::size_t>(turn % 2)];
    partials[static_cast<std::size_t>(thread)].value = value;
    meet();
    double total = 0;
    for (const Partial& partial : partials) {
      total += partial.value;
    }
    return total;
  }

 private:
  std::barrier<> barrier_;
  std::array<std::vector<Partial>, 2> partials_;
};

VectorSolver::VectorSolver(const SolverProblem& problem, int threads)
    : threads_(threads), lighting_(problem.problem.lighting) {
  order_vertices(problem.rings);
  build_rings(problem.rings);
  load_vertices(problem);
}

void VectorSolver::order_vertices(const mesh::OneRings& rings) {
  const std::size_t count = rings.on_boundary.size();
  chunk_count_ = (count + lanes - 1) / lanes;
  padded_ = chunk_count_ * lanes;
  vertex_of_.resize(count);
  std::iota(vertex_of_.begin(), vertex_of_.end(), 0);
  const auto valence = [&](std::int32_t vertex) {
    return rings.offsets[static_cast<std::size_t>(vertex) + 1] -
           rings.offsets[static_cast<std::size_t>(vertex)];
  };
  for (std::size_t begin = 0; begin < count; begin += sorting_window) {
    std::stable_sort(
        vertex_of_.begin() + static_cast<std::ptrdiff_t>(begin),
        vertex_of_.begin() + static_cast<std::ptrdiff_t>(std::min(count, begin + sorting_window)),
        [&](std::int32_t a, std::int32_t b) { return valence(a) < valence(b); });
  }
  vertex_of_.resize(padded_, -1);
  slot_of_.resize(count);
  for (std::size_t slot = 0; slot < padded_; ++slot) {
    if (vertex_of_[slot] >= 0) {
      slot_of_[static_cast<std::size_t>(vertex_of_[slot])] = static_cast<std::int32_t>(slot);
    }
  }
}

void VectorSolver::build_rings(const mesh::OneRings& rings) {
  const auto ring_begin = [&](std::int32_t vertex) {
    return rings.offsets[static_cast<std::size_t>(vertex)];
  };
  const auto valence = [&](std::int32_t vertex) {
    return vertex < 0 ? 0 : ring_begin(vertex + 1) - ring_begin(vertex);
  };
  row_begin_.assign(chunk_count_ + 1, 0);
  for (std::size_t chunk = 0; chunk < chunk_count_; ++chunk) {
    std::int32_t rows = 0;
    for (std::size_t lane = 0; lane < lanes; ++lane) {
      rows = std::max(rows, valence(vertex_of_[chunk * lanes + lane]));
    }
    row_begin_[chunk + 1] = row_begin_[chunk] + static_cast<std::size_t>(rows);
  }
  const std::size_t entries = row_begin_.back() * lanes;
  ring_.assign(entries, static_cast<std::int32_t>(padded_));
  closed_ring_.assign(entries, static_cast<std::int32_t>(padded_));
  last_.assign(padded_, static_cast<std::int32_t>(padded_));
  jacobian_.assign(entries + 1, 0.0F);
  transposed_.assign(entries, 0.0F);
  valence_.assign(padded_ + 1, 0.0F);
  const auto entry = [&](std::size_t slot, std::int32_t k) {
    return (row_begin_[slot / lanes] + static_cast<std::size_t>(k)) * lanes + slot % lanes;
  };
  for (std::size_t slot = 0; slot < padded_; ++slot) {
    const std::int32_t vertex = vertex_of_[slot];
    const std::int32_t size = valence(vertex);
    valence_[slot] = static_cast<float>(size);
    const auto neighbour = [&](std::int32_t k) {
      return slot_of_[static_cast<std::size_t>(
          rings.neighbours[static_cast<std::size_t>(ring_begin(vertex) + k)])];
    };
    for (std::int32_t k = 0; size > 0 && entry(slot, k) < row_begin_[slot / lanes + 1] * lanes; ++k) {
      closed_ring_[entry(slot, k)] = neighbour(k < size ? k : 0);
      if (k < size) {
        ring_[entry(slot, k)] = neighbour(k);
      }
    }
    if (size > 0) {
      last_[slot] = neighbour(size - 1);
    }
  }
  mirror_.assign(entries, static_cast<std::int32_t>(entries));
  for (std::size_t slot = 0; slot < padded_; ++slot) {
    for (std::int32_t k = 0; k < valence(vertex_of_[slot]); ++k) {
      const auto other = static_cast<std::size_t>(ring_[entry(slot, k)]);
      std::int32_t back = 0;
      while (ring_[entry(other, back)] != static_cast<std::int32_t>(slot)) {
        ++back;
      }
      mirror_[entry(slot, k)] = static_cast<std::int32_t>(entry(other, back));
    }
  }
}

void VectorSolver::load_vertices(const SolverProblem& problem) {
  const refine::DisplacementProblem& given = problem.problem;
  const refine::DisplacementOptions& options = problem.options;
  for (Floats* values : {&x_,
                         &y_,
                         &z_,
                         &nx_,
                         &ny_,
                         &nz_,
                         &red_,
                         &green_,
                         &blue_,
                         &albedo_red_,
                         &albedo_green_,
                         &albedo_blue_,
                         &weight_,
                         &free_,
                         &prolonged_,
                         &bend_,
                         &prior_,
                         &hierarchy_,
                         &smooth_diagonal_,
                         &start_,
                         &d_,
                         &residual_,
                         &bent_,
                         &product_,
                         &inverse_diagonal_,
                         &gradient_,
                         &search_,
                         &update_}) {
    values->assign(padded_ + 1, 0.0F);
  }
  for (std::size_t slot = 0; slot < padded_; ++slot) {
    if (vertex_of_[slot] < 0) {
      continue;
    }
    const auto v = static_cast<std::size_t>(vertex_of_[slot]);
    const auto column = static_cast<Eigen::Index>(v);
    x_[slot] = given.vertices_mm(0, column);
    y_[slot] = given.vertices_mm(1, column);
    z_[slot] = given.vertices_mm(2, column);
    nx_[slot] = given.normals(0, column);
    ny_[slot] = given.normals(1, column);
    nz_[slot] = given.normals(2, column);
    red_[slot] = given.colours(0, column);
    green_[slot] = given.colours(1, column);
    blue_[slot] = given.colours(2, column);
    albedo_red_[slot] = given.albedo(0, column);
    albedo_green_[slot] = given.albedo(1, column);
    albedo_blue_[slot] = given.albedo(2, column);
    weight_[slot] = given.data_weight[v] * given.gain;
    free_[slot] = given.fixed[v] != 0 ? 0.0F : 1.0F;
    prolonged_[slot] = given.prolonged_mm[v];
    start_[slot] = given.start_mm[v];
    const float spacing = problem.spacing_mm[v];
    bend_[slot] = std::sqrt(options.smooth_weight) / spacing / valence_[slot];
    hierarchy_[slot] = options.hierarchy_weight / (spacing * spacing);
    prior_[slot] = hierarchy_[slot] + options.coarse_weight;
  }
  for (std::size_t slot = 0; slot < padded_; ++slot) {
    const float own = bend_[slot] * valence_[slot];
    smooth_diagonal_[slot] = own * own + prior_[slot];
    for (std::size_t row = row_begin_[slot / lanes]; row < row_begin_[slot / lanes + 1]; ++row) {
      const float bend = bend_[static_cast<std::size_t>(ring_[row * lanes + slot % lanes])];
      smooth_diagonal_[slot] += bend * bend;
    }
  }
}

/// Residuals [MD19 eq. 7] and data Jacobian [MD19 eq. 8] at d_.
void VectorSolver::linearise(Chunks chunks) {
  const std::array<float, 9>& l = lighting_;
  const auto displaced = [&](const Indices& indices, std::size_t at, Vector3& normal) {
    normal = {gather(nx_, indices, at), gather(ny_, indices, at), gather(nz_, indices, at)};
    const Vector d = gather(d_, indices, at);
    return Vector3{gather(x_, indices, at) + d * normal.x, gather(y_, indices, at) + d * normal.y,
                   gather(z_, indices, at) + d * normal.z};
  };
  for (std::size_t chunk = chunks.begin; chunk < chunks.end; ++chunk) {
    const std::size_t at = chunk * lanes;
    const std::size_t first = row_begin_[chunk] * lanes;
    const std::size_t end = row_begin_[chunk + 1] * lanes;
    const Vector own = load(d_, at);
    const Vector3 centre{load(x_, at) + own * load(nx_, at), load(y_, at) + own * load(ny_, at),
                         load(z_, at) + own * load(nz_, at)};
    // The vector area of the ring, n* of [MD19 eq. 5], and the sum of d for the Laplacian.
    Vector3 star{};
    Vector ring_sum{};
    Vector3 normal{};
    const Vector3 ring_start = displaced(closed_ring_, first, normal) - centre;
    Vector3 current = ring_start;
    for (std::size_t entry = first; entry < end; entry += lanes) {
      const Vector3 next =
          entry + lanes < end ? displaced(closed_ring_, entry + lanes, normal) - centre : ring_start;
      const Vector3 area = cross(current, next);
      star = {star.x + area.x, star.y + area.y, star.z + area.z};
      ring_sum += gather(d_, ring_, entry);
      current = next;
    }
    store(bent_, at, load(bend_, at) * (load(valence_, at) * own - ring_sum));

    const Vector inverse_length = 1.0F / square_root(dot(star, star) + 1e-30F);
    const Vector3 n{star.x * inverse_length, star.y * inverse_length, star.z * inverse_length};
    const Vector shade = l[0] + l[1] * n.x + l[2] * n.y + l[3] * n.z + l[4] * n.x * n.y + l[5] * n.x * n.z +
                         l[6] * n.y * n.z + l[7] * (n.x * n.x - n.y * n.y) + l[8] * (3 * n.z * n.z - 1);
    const Vector3 gradient{l[1] + l[4] * n.y + l[5] * n.z + 2 * l[7] * n.x,
                           l[2] + l[4] * n.x + l[6] * n.z - 2 * l[7] * n.y,
                           l[3] + l[5] * n.x + l[6] * n.y + 6 * l[8] * n.z};
    const Vector3 albedo{load(albedo_red_, at), load(albedo_green_, at), load(albedo_blue_, at)};
    const Vector3 colour{load(red_, at), load(green_, at), load(blue_, at)};
    const Vector root = square_root(load(weight_, at));
    const Vector brightness = square_root(dot(albedo, albedo)) + 1e-30F;
    const Vector3 difference = colour - Vector3{shade * albedo.x, shade * albedo.y, shade * albedo.z};
    store(residual_, at, root * dot(albedo, difference) / brightness);

    const Vector along = dot(n, gradient);
    const Vector scale = root * brightness * inverse_length;
    const Vector3 slope{scale * (gradient.x - along * n.x), scale * (gradient.y - along * n.y),
                        scale * (gradient.z - along * n.z)};
    Vector3 previous = displaced(last_, at, normal);
    Vector3 here_normal{};
    Vector3 here = displaced(closed_ring_, first, here_normal);
    const Vector3 start = here;
    const Vector size = load(valence_, at);
    float k = 0;
    for (std::size_t entry = first; entry < end; entry += lanes, k += 1) {
      Vector3 next_normal{};
      const Vector3 next = entry + lanes < end ? displaced(closed_ring_, entry + lanes, next_normal) : start;
      const Vector change = dot(slope, cross(here_normal, next - previous));
      store(jacobian_, entry, where(Mask(size > k), change));
      previous = here;
      here = next;
      here_normal = next_normal;
    }
  }
}

/// J^T r, the Jacobi preconditioner and the first direction; returns r . z.
double VectorSolver::start_search(Chunks chunks) {
  Vector total{};
  for (std::size_t chunk = chunks.begin; chunk < chunks.end; ++chunk) {
    const std::size_t at = chunk * lanes;
    Vector diagonal = load(smooth_diagonal_, at);
    const Vector own = load(d_, at);
    const Vector hierarchy = load(hierarchy_, at);
    Vector right = hierarchy * load(prolonged_, at) - load(prior_, at) * own -
                   load(bend_, at) * load(valence_, at) * load(bent_, at);
    for (std::size_t entry = row_begin_[chunk] * lanes; entry < row_begin_[chunk + 1] * lanes;
         entry += lanes) {
      const Vector jacobian = gather(jacobian_, mirror_, entry);
      store(transposed_, entry, jacobian);
      diagonal += jacobian * jacobian;
      right += jacobian * gather(residual_, ring_, entry) +
               gather(bend_, ring_, entry) * gather(bent_, ring_, entry);
    }
    const Vector free = load(free_, at);
    const Vector inverse = free / (diagonal + 1e-30F);
    const Vector preconditioned = inverse * right;
    store(inverse_diagonal_, at, inverse);
    store(gradient_, at, right * free);
    store(search_, at, preconditioned);
    store(update_, at, Vector{});
    total += right * preconditioned;
  }
  return sum(total);
}

/// J p and L p; returns p . A p.
double VectorSolver::products(Chunks chunks) {
  double total = 0;
  for (std::size_t chunk = chunks.begin; chunk < chunks.end; ++chunk) {
    const std::size_t at = chunk * lanes;
    Vector data{};
    Vector ring_sum{};
    for (std::size_t entry = row_begin_[chunk] * lanes; entry < row_begin_[chunk + 1] * lanes;
         entry += lanes) {
      const Vector p = gather(search_, ring_, entry);
      data += load(jacobian_, entry) * p;
      ring_sum += p;
    }
    const Vector own = load(search_, at);
    const Vector bend = load(bend_, at) * (load(valence_, at) * own - ring_sum);
    store(product_, at, data);
    store(bent_, at, load(bend_, at) * bend);
    total += sum(data * data + bend * bend + load(prior_, at) * own * own);
  }
  return total;
}

/// x += alpha p, r -= alpha A p; returns the new r . z.
double VectorSolver::descend(Chunks chunks, float alpha) {
  double total = 0;
  for (std::size_t chunk = chunks.begin; chunk < chunks.end; ++chunk) {
    const std::size_t at = chunk * lanes;
    const Vector own = load(search_, at);
    Vector product = load(prior_, at) * own + load(valence_, at) * load(bent_, at);
    for (std::size_t entry = row_begin_[chunk] * lanes; entry < row_begin_[chunk + 1] * lanes;
         entry += lanes) {
      product += load(transposed_, entry) * gather(product_, ring_, entry) - gather(bent_, ring_, entry);
    }
    const Vector gradient = load(gradient_, at) - alpha * product * load(free_, at);
    store(update_, at, load(update_, at) + alpha * own);
    store(gradient_, at, gradient);
    total += sum(gradient * gradient * load(inverse_diagonal_, at));
  }
  return total;
}

/// p = z + beta p.
void VectorSolver::next_direction(Chunks chunks, float beta) {
  for (std::size_t at = chunks.begin * lanes; at < chunks.end * lanes; at += lanes) {
    store(search_, at, load(inverse_diagonal_, at) * load(gradient_, at) + beta * load(search_, at));
  }
}

void VectorSolver::move(Chunks chunks) {
  for (std::size_t at = chunks.begin * lanes; at < chunks.end * lanes; at += lanes) {
    store(d_, at, load(d_, at) + load(update_, at));
  }
}

void VectorSolver::run(Crew& crew, int thread, int steps, int pcg_iterations) {
  const auto share = [&](int index) {
    return chunk_count_ * static_cast<std::size_t>(index) / static_cast<std::size_t>(threads_);
  };
  const Chunks chunks{share(thread), share(thread + 1)};
  int turn = 0;
  for (int step = 0; step < steps; ++step) {
    linearise(chunks);
    crew.meet();
    double descent = crew.sum(thread, turn++, start_search(chunks));
    for (int iteration = 0; iteration < pcg_iterations && descent > 0; ++iteration) {
      const double curvature = crew.sum(thread, turn++, products(chunks));
      const double next = crew.sum(thread, turn++, descend(chunks, static_cast<float>(descent / curvature)));
      next_direction(chunks, static_cast<float>(next / descent));
      descent = next;
      crew.meet();
    }
    move(chunks);
    crew.meet();
  }
}

VectorResult VectorSolver::solve(int steps, int pcg_iterations) {
  d_ = start_;
  Crew crew(threads_);
  const auto start = std::chrono::steady_clock::now();
  std::vector<std::thread> threads;  // joined below; they run the solve and nothing else
  threads.reserve(static_cast<std::size_t>(threads_));
  for (int thread = 1; thread < threads_; ++thread) {
    threads.emplace_back(
        [this, &crew, thread, steps, pcg_iterations] { run(crew, thread, steps, pcg_iterations); });
  }
  run(crew, 0, steps, pcg_iterations);
  for (std::thread& thread : threads) {
    thread.join();
  }
  const std::chrono::duration<double, std::milli> elapsed = std::chrono::steady_clock::now() - start;
  VectorResult result;
  result.step_ms = elapsed.count() / steps;
  result.displacements_mm.resize(slot_of_.size());
  for (std::size_t vertex = 0; vertex < slot_of_.size(); ++vertex) {
    result.displacements_mm[vertex] = d_[static_cast<std::size_t>(slot_of_[vertex])];
  }
  return result;
}

}  // namespace facet::bench
