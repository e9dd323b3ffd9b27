// Ceres Solver on the fits of `benchmarks.ceres`: automatic differentiation, dense normal equations, arms side by
// side on the threads that are given. Reads doubles from one file and writes doubles to another:
// in:  arms, samples, threads, repeats, scale of m, scale of rad, start (28), then an arm's joints (sample x 6) and poses
//      (sample x 12, rows of the rotation and the position) after the other;
// out: least wall seconds, processor seconds of that run, then 28 parameters and the steps of each arm.

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <time.h>

#include <atomic>
#include <chrono>
#include <fstream>
#include <thread>
#include <vector>

constexpr int kSize = 28;

template <typename T>
struct Frame {
  T axis[3][3];  // axis[i] is the i-th axis of the frame
  T origin[3];

  void turn(int about, const T& angle) {
    const T c = cos(angle), s = sin(angle);
    T *a = axis[(about + 1) % 3], *b = axis[(about + 2) % 3];
    for (int i = 0; i < 3; ++i) {
      const T old = a[i];
      a[i] = c * old + s * b[i];
      b[i] = c * b[i] - s * old;
    }
  }
  void move(int along, const T& by) {
    for (int i = 0; i < 3; ++i) origin[i] += by * axis[along][i];
  }
};

struct Residual {
  const double *q, *pose;
  double metre, radian;

  template <typename T>
  bool operator()(const T* p, T* out) const {
    Frame<T> f;
    for (int i = 0; i < 3; ++i) {
      f.origin[i] = T(0);
      for (int j = 0; j < 3; ++j) f.axis[i][j] = T(i == j);
    }
    f.move(0, p[0]);
    f.move(1, p[1]);
    f.turn(1, p[3]);
    f.turn(0, p[2]);
    int next = 4;
    for (int joint = 0; joint < 6; ++joint) {
      f.turn(2, p[next++] + q[joint]);
      if (joint != 1) f.move(2, p[next++]);
      f.move(0, p[next++]);
      f.turn(0, p[next++]);
      if (joint == 1) f.turn(1, p[27]);
    }
    T relative[9];  // measured^T predicted, column by column as Ceres has it
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i)
        relative[3 * j + i] = pose[i] * f.axis[j][0] + pose[3 + i] * f.axis[j][1] + pose[6 + i] * f.axis[j][2];
    T spin[3];
    ceres::RotationMatrixToAngleAxis(relative, spin);
    for (int i = 0; i < 3; ++i) {
      out[i] = metre * (f.origin[i] - pose[9 + i]);
      out[3 + i] = radian * spin[i];
    }
    return true;
  }
};

double fit(const double* q, const double* pose, int samples, double metre, double radian, double* p) {
  ceres::Problem problem;
  for (int k = 0; k < samples; ++k)
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Residual, 6, kSize>(
                                 new Residual{q + 6 * k, pose + 12 * k, metre, radian}),
                             nullptr, p);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.initial_trust_region_radius = 1e8;
  options.function_tolerance = options.parameter_tolerance = 1e-14;
  options.gradient_tolerance = 1e-12;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return static_cast<double>(summary.num_successful_steps);
}

int main(int, char** argv) {
  std::ifstream in(argv[1], std::ios::binary);
  std::vector<double> head(6 + kSize);
  in.read(reinterpret_cast<char*>(head.data()), head.size() * sizeof(double));
  const int arms = head[0], samples = head[1], threads = head[2], repeats = head[3];
  std::vector<double> data(static_cast<size_t>(arms) * samples * 18), best(2 + arms * (kSize + 1), 1e300);
  in.read(reinterpret_cast<char*>(data.data()), data.size() * sizeof(double));
  for (int repeat = 0; repeat < repeats; ++repeat) {
    std::vector<double> found(2 + arms * (kSize + 1));
    std::atomic<int> next{0};
    timespec before, after;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &before);
    const auto start = std::chrono::steady_clock::now();
    std::vector<std::thread> pool;
    for (int t = 0; t < threads; ++t)
      pool.emplace_back([&] {
        for (int arm; (arm = next++) < arms;) {
          double* p = &found[2 + arm * (kSize + 1)];
          std::copy(head.begin() + 6, head.end(), p);
          const double* q = &data[static_cast<size_t>(arm) * samples * 18];
          p[kSize] = fit(q, q + 6 * samples, samples, head[4], head[5], p);
        }
      });
    for (auto& each : pool) each.join();
    found[0] = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &after);
    found[1] = (after.tv_sec - before.tv_sec) + 1e-9 * (after.tv_nsec - before.tv_nsec);
    if (found[1] < best[1]) best = found;
  }
  std::ofstream(argv[2], std::ios::binary).write(reinterpret_cast<char*>(best.data()), best.size() * sizeof(double));
}
