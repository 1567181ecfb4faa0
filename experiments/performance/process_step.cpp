// The cutting process of an upright flat end mill along a given path, in plain C++: one
// thread, simple loops, the mathematics of `diffmill.process` and `diffmill.workpiece`.
// It is what `process.py` measures JAX against, and its names are theirs.
//
//     process_step INPUT OUTPUT PARTS
//
// INPUT holds named arrays of numbers (see `Input`). OUTPUT takes, segment by segment,
// force per period, volume per pose and the material left on every ray. PARTS is 1 for
// the removal alone, 2 for the look-up too, 3 for all. All segments are cut twice: what
// is printed is the processor time of the second time [s].
//
// It leaves out what is zero anyway, as one writes loops: discs in the air are not
// looked up among the rays across, and have no force.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <iostream>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

using Vec3 = std::array<double, 3>;

constexpr double kPi = 3.141592653589793;
constexpr double kDead = 1e3;        // ends of an empty slot [m]
constexpr double kFar = 1e3;         // where the shank ends [m]
constexpr double kShortest = 1e-9;   // shorter pieces of a ray are dropped [m]
constexpr double kGraze = 0.02;      // half a chord over the radius that only touches
constexpr double kTouch = 1e-9;      // rays nearer to the tip's height only touch [m]
constexpr double kStill = 1e-8;      // less motion has no direction [m]
constexpr double kAside = 0.02;
constexpr double kBlind = 1e-6;      // what a ray without a surface counts for
constexpr int kTicks = 2048;         // parts of a tooth period that ends remember
constexpr int kFine = 8;             // parts of a sub-step in which columns are cut
constexpr int kQueue = 48, kHistory = 512, kRemovals = 2;
constexpr double kThinned[] = {0.25, 0.5, 0.75, 1.0};

double clamp(double low, double x, double high) {
  return std::min(std::max(x, low), high);
}
int clamp_index(int low, int i, int high) { return std::min(std::max(i, low), high); }

// ---- smooth steps ---------------------------------------------------------------

double hat_integral(double x) {
  x = clamp(-1, x, 1);
  return 0.5 + x - 0.5 * x * std::abs(x);
}

double integrated_twice(double x) {
  const double c = clamp(-1, x, 1), a = std::abs(c);
  return 1.0 / 6 + 0.5 * c + 0.5 * c * c - a * a * a / 6 + std::max(x - 1, 0.0);
}

double ramp(double x, double width) { return width * integrated_twice(x / width); }

double mean_step(double x, double width, double length) {
  x /= width;
  const double half = 0.5 * length / width;
  return (integrated_twice(x + half) - integrated_twice(x - half)) / (2 * half);
}

Vec3 spline(double t) {
  return {0.5 * (0.5 - t) * (0.5 - t), 0.75 - t * t, 0.5 * (0.5 + t) * (0.5 + t)};
}

double norm(const Vec3& a, const Vec3& b) {
  const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return std::sqrt(x * x + y * y + z * z);
}

// Abramowitz and Stegun, 4.4.49, as the rays of every step need it cheap.
double turn_between(double ahead, double aside) {
  const double x = std::abs(ahead), y = std::abs(aside), greater = std::max(x, y);
  if (greater < 1e-30) return 0;
  const double t = std::min(x, y) / greater, s = t * t;
  double turn = 0.0208351;
  for (double c : {-0.0851330, 0.1801410, -0.3302995, 0.9998660}) turn = turn * s + c;
  turn *= t;
  if (y > x) turn = kPi / 2 - turn;
  if (ahead < 0) turn = kPi - turn;
  return aside < 0 ? -turn : turn;
}

// ---- what is read ---------------------------------------------------------------

// Arrays by name: a line "name count", then that many doubles.
struct Input {
  std::map<std::string, std::vector<double>> arrays;

  explicit Input(const char* file) {
    std::ifstream in(file, std::ios::binary);
    if (!in) throw std::runtime_error(std::string("cannot read ") + file);
    std::string name;
    size_t count;
    while (in >> name >> count) {
      in.get();
      auto& values = arrays[name];
      values.resize(count);
      in.read(reinterpret_cast<char*>(values.data()), count * sizeof(double));
    }
  }
  const std::vector<double>& of(const std::string& name) const {
    const auto found = arrays.find(name);
    if (found == arrays.end()) throw std::runtime_error("INPUT has no " + name);
    return found->second;
  }
  double number(const std::string& name) const { return of(name).at(0); }
  int count(const std::string& name) const { return int(number(name)); }
  Vec3 vector(const std::string& name) const {
    const auto& v = of(name);
    return {v.at(0), v.at(1), v.at(2)};
  }
  void require(const std::string& name, double wanted) const {
    if (number(name) != wanted)
      throw std::runtime_error("covered is only " + name + " = " +
                               std::to_string(wanted) + ", but found " +
                               std::to_string(number(name)));
  }
};

// One family of rays: per ray its lower ends, then its upper ends, each a slot.
struct Rays {
  int rows, columns, slots, in_use;
  std::vector<double> ends;
  std::vector<int> ticks;

  size_t at(int u, int v) const { return (size_t(u) * columns + v) * 2 * slots; }
};

struct Stock {
  std::array<Rays, 3> families;
  Vec3 origin;
  double spacing, top;
  std::array<int, 3> counts;  // grid lines along x, y and z

  explicit Stock(const Input& in)
      : origin(in.vector("origin")), spacing(in.number("spacing")),
        top(in.number("top")) {
    for (int f = 0; f < 3; ++f) {
      const std::string axis(1, "xyz"[f]);
      const Vec3 shape = in.vector("shape_" + axis);
      Rays& rays = families[f];
      rays.rows = int(shape[0]), rays.columns = int(shape[1]);
      rays.slots = int(shape[2]);
      rays.ends = in.of("ends_" + axis);
      rays.ticks.assign(rays.ends.size(), -1);
      rays.in_use = 0;
      for (size_t i = 0; i < rays.ends.size(); i += 2 * rays.slots)
        for (int m = 0; m < rays.slots; ++m)
          if (rays.ends[i + rays.slots + m] > rays.ends[i + m])
            rays.in_use = std::max(rays.in_use, m + 1);
      counts[(f + 1) % 3] = rays.rows;
    }
  }
};

// Cutter, force law and how finely both are sampled.
struct Settings {
  double diameter, R, flute_length, height, band, lag, slack, angle_step;
  int teeth, substeps, discs, per_substep;
  Vec3 window;
  std::vector<double> K;  // K_tc K_rc K_ac K_te K_re K_ae
  std::vector<double> sin, cos;  // of tooth 0 at each sample of a period

  explicit Settings(const Input& in) {
    in.require("flute_count", 2);
    for (const char* name : {"helix_angle", "dish_angle", "corner_radius", "runout",
                             "uneven_pitch", "bottom_edges", "shank_in_stock"})
      in.require(name, 0);
    diameter = in.number("diameter"), R = diameter / 2;
    flute_length = in.number("flute_length");
    height = in.number("disc_height"), band = in.number("band");
    lag = in.number("lag"), slack = in.number("slack"), window = in.vector("window");
    teeth = 2, substeps = in.count("substeps"), discs = in.count("disc_count");
    K = in.of("coefficients");
    if (K.size() != 6) throw std::runtime_error("coefficients per tooth: not covered");
    const int angles = in.count("angles"), samples = angles / teeth;
    angle_step = 2 * kPi / angles, per_substep = samples / substeps;
    for (int i = 0; i < samples; ++i) {
      const double turn = 2 * kPi / teeth * ((i + 0.5) / samples);
      sin.push_back(std::sin(turn)), cos.push_back(std::cos(turn));
    }
  }
};

// ---- chip -----------------------------------------------------------------------

// What one earlier circle, shifted by `offset` while the cutter turned by the inverse of
// `inverse_turn`, leaves along the radius of a tooth.
double circle_chip(double R, double x, double y, double sin, double cos,
                   double missed, double inverse_turn) {
  const double lead = (x * cos - y * sin) / R * inverse_turn;
  const double share = 1 / (1 - clamp(-0.5, lead, 0.5));
  const double outward = share * (x * sin + y * cos);
  const double sideways = share * (x * cos - y * sin);
  const double square = R * R - sideways * sideways;
  return square > 0 ? R - outward - std::sqrt(square) : missed;
}

// Sine of the angle by which a tooth has entered the half turn ahead of the tool.
double lead_of(double x, double y, double sin, double cos) {
  const double way = std::sqrt(x * x + y * y + kStill * kStill);
  return (sin * x + cos * y) / way;
}

double faded(double x) { return hat_integral(4 * x - 1); }

// Where teeth change places at the ends of that half turn, what one has lost counts for
// the next samples of the other: contact, and chip.
struct TakenOver {
  double contact, chip;

  TakenOver(double lead, double angle_step, double before) {
    const double b = before / angle_step, x = clamp(1e-3, lead / angle_step, 2);
    const double u = clamp(0, 1 - std::abs(x - 1), 1), spread = u * u * (3 - 2 * u);
    const double W = hat_integral(x - 1) + (1 + b) * spread;
    const double V = integrated_twice(x - 1) + (1 + b) * hat_integral(x - 1) +
                     ((1 + b) * (1 + b) / 2 - 1.0 / 24) * spread;
    contact = W / (faded(x) * hat_integral(x + b));
    chip = V / ((x + b) * faded(x));
  }
};

// ---- look-up of the stock -------------------------------------------------------

// A point on the rim at the height of the tip, and the ways from there across the axis.
struct Rim {
  Vec3 place;
  double move[2];  // to the next sample
  double chip[2];  // to the inner side of the chip
};

// Per disc: share of its height with a chip in the stock, and of that chip's thickness.
struct Look {
  double occupancy, chip_share;
};

int nearest_line(const Stock& stock, int axis, double x) {
  const double at = std::nearbyint((x - stock.origin[axis]) / stock.spacing);
  return clamp_index(1, int(at), stock.counts[axis] - 2);
}

// From the nearest grid line, in spacings.
double off_line(const Stock& stock, int axis, double x) {
  const double at = (x - stock.origin[axis]) / stock.spacing;
  return at - std::nearbyint(at);
}

// Share of disc e below a height above the tip; the lowest disc ends at the tip.
double filled_below(double above, double height, int e) {
  above = std::max(above, 0.0);
  const double share = hat_integral(above / height - (e + 0.5));
  return e == 0 ? share - hat_integral(-above / height - 0.5) : share;
}

struct Wall {
  double distance;  // inside the material is positive
  bool is_upper;
};

// Distance to the end that decides on one ray, cut off at `reach`.
Wall wall_on_ray(const Rays& rays, int u, int v, double x, double reach) {
  const double *low = &rays.ends[rays.at(u, v)], *high = low + rays.slots;
  int nearest = 0;
  double best = std::min(x - low[0], high[0] - x);
  for (int m = 1; m < rays.in_use; ++m) {
    const double inside = std::min(x - low[m], high[m] - x);
    if (inside > best) best = inside, nearest = m;
  }
  const double a = low[nearest], b = high[nearest];
  const bool is_upper = b - x < x - a;
  if (b < a) return {-reach, is_upper};
  return {clamp(-reach, is_upper ? b - x : x - a, reach), is_upper};
}

// What the rays along x and y say of a wall at a height.
struct WallOccupancy {
  double touched, filled, certainty;

  WallOccupancy(const Stock& stock, double band, const Rim& rim, double height) {
    const double d = stock.spacing, reach = 4 * d;
    const double at_height = (height - stock.origin[2]) / d;
    const double q = at_height - std::floor(at_height);
    const int below = clamp_index(0, int(std::floor(at_height)), stock.counts[2] - 2);
    double total = 0, says = kBlind, sure = 0, ahead = 0, inward = 0;
    for (int f = 0; f < 2; ++f) {
      const int side = 1 - f;
      const int middle = nearest_line(stock, side, rim.place[side]);
      double s[3];
      double sign = 1;
      for (int i = 0; i < 3; ++i) {
        double weighted = 0, weights = 0;
        for (int k = 0; k < 2; ++k) {
          const int line = middle - 1 + i, level = below + k;
          const Wall wall = wall_on_ray(stock.families[f], f == 0 ? line : level,
                                        f == 0 ? level : line, rim.place[f], reach);
          const double x = wall.distance / reach, sees = (1 - x * x) * (1 - x * x);
          const double weight = (k == 0 ? 1 - q : q) * (sees + kBlind);
          weighted += weight * wall.distance, weights += weight;
          if (i == 1 && k == 0) sign = wall.is_upper ? 1 : -1;
        }
        s[i] = weighted / weights;
      }
      const double t = off_line(stock, side, rim.place[side]);
      const double slope = ((0.5 - t) * (s[1] - s[0]) + (0.5 + t) * (s[2] - s[1])) / d;
      const Vec3 B = spline(t);
      const double here = B[0] * s[0] + B[1] * s[1] + B[2] * s[2], x = here / reach;
      const double steepness = 1 + slope * slope, root = std::sqrt(steepness);
      const double say = (1 - x * x) * (1 - x * x) / (steepness * steepness);
      const double crossed = slope * rim.move[side] - sign * rim.move[f];
      const double deeper = slope * rim.chip[side] - sign * rim.chip[f];
      ahead += (say + kBlind) * std::abs(crossed) / root;
      inward += (say + kBlind) * deeper / root;
      total += (say + kBlind) * here / root;
      says += say + kBlind;
      sure += say;
    }
    // A wall that an edge follows rather than crosses is not blurred along its way.
    const double followed = 0.3 * band, corner = 0.2 * band;
    double width = followed + ramp(ahead / says - followed, corner);
    width -= ramp(width - band, corner);
    const double inside = total / says;
    inward /= says;
    const double length = std::sqrt(inward * inward + 1e-4 * width * width);
    touched = hat_integral((inside + (inward + length) / 2) / width);
    filled = mean_step(inside + inward / 2, width, length);
    sure *= 2 * 1.3;
    certainty = sure - ramp(sure - 1, 0.3);
  }
};

// Occupancy of all discs at a point: columns tell the height, rays across tell walls.
void look_up(const Stock& stock, const Settings& set, const Rim& rim, Look* found) {
  const Rays& rays = stock.families[2];
  const double d = stock.spacing, z = rim.place[2];
  const int i0 = nearest_line(stock, 0, rim.place[0]);
  const int j0 = nearest_line(stock, 1, rim.place[1]);
  const Vec3 along_x = spline(off_line(stock, 0, rim.place[0]));
  const Vec3 along_y = spline(off_line(stock, 1, rim.place[1]));
  for (int e = 0; e < set.discs; ++e) {
    const double middle = z + set.height * (e + 0.5);
    double filled[9], fullest = 0, top = -INFINITY;
    for (int ray = 0; ray < 9; ++ray) {
      const double* low = &rays.ends[rays.at(i0 - 1 + ray / 3, j0 - 1 + ray % 3)];
      const double* high = low + rays.slots;
      filled[ray] = 0;
      for (int m = 0; m < rays.slots; ++m) {
        if (!(high[m] > low[m])) continue;
        filled[ray] += filled_below(high[m] - z, set.height, e) -
                       filled_below(low[m] - z, set.height, e);
        if (low[m] < middle + set.height) top = std::max(top, high[m]);
      }
      fullest = std::max(fullest, filled[ray]);
    }
    found[e] = {0, 0};
    // Where the columns are in the air the walls have nothing to say.
    if (fullest == 0) continue;
    double mean = 0, square = 0, gaps = 0, weighted_gaps = 0;
    for (int ray = 0; ray < 9; ++ray) {
      const double weight = along_x[ray / 3] * along_y[ray % 3];
      const double gap = fullest - filled[ray];
      mean += weight * filled[ray], square += weight * filled[ray] * filled[ray];
      gaps += weight * gap, weighted_gaps += weight * filled[ray] * gap;
    }
    const double solid = square / (mean + kBlind);
    const double ledge = weighted_gaps / (gaps + kBlind);
    // A disc that only just reaches into the material is looked at below its top.
    const bool is_fringe = top < middle + d && top > middle - set.height;
    const WallOccupancy wall(stock, set.band, rim, is_fringe ? top - d : middle);
    const double ground = wall.certainty * ledge;
    const double rise = wall.certainty * (solid - ledge) + (1 - wall.certainty) * mean;
    const double touching = ground + rise * wall.touched;
    found[e] = {touching, (ground + rise * wall.filled) / (touching + kBlind)};
  }
}

// ---- removal --------------------------------------------------------------------

// The poses of the tool while one tooth goes around once, at equal steps of time.
struct ToothPass {
  const Vec3* nodes;
  int count, first, substeps;
  double forward[2], passing, last;

  Vec3 at(double node) const {
    if (count == 1) return nodes[0];
    const int low = clamp_index(0, int(node), count - 2);
    const double share = node - low;
    Vec3 tip;
    for (int a = 0; a < 3; ++a)
      tip[a] = nodes[low][a] + share * (nodes[low + 1][a] - nodes[low][a]);
    return tip;
  }
  Vec3 center() const { return at(clamp(0, passing, last)); }
  double first_ticks() const { return double(first % substeps * (kTicks / substeps)); }
  // Node at which the tooth looks at a place, in whole ticks.
  double when(double x, double y) const {
    const double turn = turn_between(x * forward[0] + y * forward[1],
                                     x * forward[1] - y * forward[0]);
    const double node = clamp(0, passing + substeps / kPi * turn, last);
    const double per_node = kTicks / substeps, part = first_ticks();
    return std::min((std::nearbyint(node * per_node + part) - part) / per_node, last);
  }
  int ticks(double node) const {
    return first / substeps * kTicks +
           int(std::nearbyint(node * (kTicks / substeps) + first_ticks()));
  }
};

struct Cut {
  double start, stop;
  int started, stopped;
};

// Take a piece off a ray; returns its length.
double subtract(Rays& rays, size_t at, const Cut& cut) {
  const int slots = rays.slots;
  double *low = &rays.ends[at], *high = low + slots, length = 0;
  int *low_ticks = &rays.ticks[at], *high_ticks = low_ticks + slots;
  for (int m = 0, in_use = rays.in_use; m < in_use; ++m) {
    const double a = low[m], b = high[m];
    if (!(b > a && cut.start < b && cut.stop > a)) continue;
    const bool keeps_low = a < cut.start - kShortest;
    const bool keeps_high = b > cut.stop + kShortest;
    length += b - a;
    if (keeps_low && keeps_high) {
      int free = 0;
      while (free < slots && high[free] > low[free]) ++free;
      if (free == slots) throw std::runtime_error("a ray has no free slot");
      low[free] = cut.stop, high[free] = b;
      low_ticks[free] = cut.stopped, high_ticks[free] = high_ticks[m];
      length -= b - cut.stop;
      rays.in_use = std::max(rays.in_use, free + 1);
    }
    if (keeps_low) {
      high[m] = cut.start, high_ticks[m] = cut.started;
    } else if (keeps_high) {
      low[m] = cut.stop, low_ticks[m] = cut.stopped;
    } else {
      low[m] = kDead, high[m] = -kDead;
    }
    length -= std::max(high[m] - low[m], 0.0);
  }
  return length;
}

// Grid lines of a window around a pose.
struct Window {
  int starts[3], sizes[3];
  bool is_short;

  Window(const Stock& stock, const Settings& set, const Vec3& tip) {
    for (int a = 0; a < 3; ++a) {
      sizes[a] = int(set.window[a]);
      const int line = int(std::floor((tip[a] - stock.origin[a]) / stock.spacing));
      const int before = a == 2 ? 1 : sizes[a] / 2 - 1;
      starts[a] = clamp_index(0, line - before, stock.counts[a] - sizes[a]);
    }
    const int end = starts[2] + sizes[2];
    is_short = end < stock.counts[2] &&
               stock.origin[2] + stock.spacing * (end - 1) < stock.top;
  }
};

// Take what a tooth passes over off the columns; returns their length.
double remove_columns(Stock& stock, double R, const Window& window,
                      const ToothPass& pass) {
  const Vec3 center = pass.center();
  // Columns are many: they take the nearest of finer nodes.
  std::vector<Vec3> nodes;
  for (int i = 0; i <= (pass.count - 1) * kFine; ++i)
    nodes.push_back(pass.at(double(i) / kFine));
  ToothPass fine = pass;
  fine.nodes = nodes.data(), fine.count = int(nodes.size());
  fine.first *= kFine, fine.substeps *= kFine;
  fine.passing *= kFine, fine.last *= kFine;
  double length = 0;
  for (int i = window.starts[0]; i < window.starts[0] + window.sizes[0]; ++i) {
    const double x = stock.origin[0] + stock.spacing * i;
    for (int j = window.starts[1]; j < window.starts[1] + window.sizes[1]; ++j) {
      const double y = stock.origin[1] + stock.spacing * j;
      const double node = std::nearbyint(fine.when(x - center[0], y - center[1]));
      const Vec3& tip = fine.nodes[int(node)];
      const double dx = x - tip[0], dy = y - tip[1];
      if (!(dx * dx + dy * dy < R * R)) continue;
      const int when = fine.ticks(node);
      Rays& rays = stock.families[2];
      length += subtract(rays, rays.at(i, j), {tip[2], kFar, when, when});
    }
  }
  return length;
}

// The same of the rays along x (family 0) or y (family 1).
double remove_across(Stock& stock, double R, int f, const Window& window,
                     const ToothPass& pass) {
  const Vec3 center = pass.center();
  const int side = 1 - f;
  double length = 0;
  Rays& rays = stock.families[f];
  for (int i = window.starts[side]; i < window.starts[side] + window.sizes[side]; ++i) {
    const double line = stock.origin[side] + stock.spacing * i;
    // Where an end lies tells when it is cut, and that where it lies: twice in turn.
    double end[2], node[2];
    Vec3 pose[2] = {center, center};
    bool is_hit = true;
    for (int stop = 0; stop < 2; ++stop) {
      for (int round = 0; round < 3; ++round) {
        const double across = line - pose[stop][side], square = R * R - across * across;
        const bool hits = square > kGraze * kGraze * R * R;
        const double half = hits ? std::sqrt(square) : 1, along = stop ? half : -half;
        end[stop] = pose[stop][f] + along;
        if (round == 2) {
          is_hit = is_hit && hits;
        } else {
          const double reached = hits ? along : 0;
          node[stop] = f == 0 ? pass.when(reached, across) : pass.when(across, reached);
          pose[stop] = pass.at(node[stop]);
        }
      }
    }
    if (!is_hit || !(end[0] < end[1])) continue;
    const Cut cut{end[0], end[1], pass.ticks(node[0]), pass.ticks(node[1])};
    for (int k = window.starts[2]; k < window.starts[2] + window.sizes[2]; ++k) {
      const double z = stock.origin[2] + stock.spacing * k;
      if (!(z - pose[0][2] > kTouch && z - pose[1][2] > kTouch)) continue;
      length += subtract(rays, f == 0 ? rays.at(i, k) : rays.at(k, i), cut);
    }
  }
  return length;
}

// Remove one pass; returns the volume, which the columns tell.
double remove_pass(Stock& stock, double R, const Window& window,
                   const ToothPass& pass) {
  double across = 0;
  for (int f = 0; f < 2; ++f) across += remove_across(stock, R, f, window, pass);
  const double length = remove_columns(stock, R, window, pass);
  if (window.is_short && length + across > 0)
    throw std::runtime_error("the tool reaches beyond its window");
  return length * stock.spacing * stock.spacing;
}

// ---- the process, one tooth period after another --------------------------------

struct Waiting {
  int row;
  double forward[2], passing, travel;
};

struct Sample {
  double sin, cos, fade;
  std::vector<Look> discs;

  bool is_met() const {
    for (const Look& disc : discs)
      if (fade * disc.occupancy != 0) return true;
    return false;
  }
};

class Process {
 public:
  std::vector<Vec3> force;     // mean of each period [N]
  std::vector<double> volume;  // that each pose removes [m^3]
  Stock stock;

  Process(const Settings& settings, const Stock& raw, const Vec3* path, int pose_count)
      : stock(raw), set(settings), path(path), pose_count(pose_count) {}

  void run(int parts) {
    begin();
    for (int k = 1; k < pose_count; ++k) {
      place_substeps(k);
      enqueue(k - 1);
      remove_lagged(k - 1);
      find_thinned();
      Vec3 sum = {0, 0, 0};
      for (int s = 0; s < set.substeps; ++s) {
        if (parts > 1) look(s);
        if (parts > 2) push(s, sum);
      }
      for (double& F : sum) F /= set.substeps * set.per_substep;
      force.push_back(sum);
      recent[1] = recent[0], recent[0] = middles, ends = next_ends;
    }
    finish();
  }

 private:
  const Settings& set;
  const Vec3* path;
  int pose_count;
  std::vector<Vec3> track;                        // at the ends of all sub-steps
  std::vector<Vec3> middles, ends, next_ends;     // of a period
  std::array<std::vector<Vec3>, 2> recent;        // middles of the last periods
  std::vector<Vec3> thinned;                      // older poses
  std::vector<Sample> samples;
  std::vector<Waiting> queue;
  Vec3 last_tip;
  double forward[2] = {0, 1}, passing = 0, travel = 0;

  int pass_length() const { return set.teeth * set.substeps + 3; }
  int wait() const { return int(std::ceil(0.5 * set.teeth + 1.5)); }

  void begin() {
    const int nodes = std::max((pose_count - 1) * set.substeps + 1, pass_length());
    track.assign(nodes, path[0]), ends.assign(set.substeps, path[0]);
    next_ends = middles = recent[0] = recent[1] = ends;
    queue.assign(1, {0, {0, 1}, 0, 0});
    last_tip = path[0];
    Sample none{0, 0, 0, std::vector<Look>(set.discs)};
    samples.assign(set.substeps * set.per_substep, none);
    volume.assign(pose_count, 0);
    const ToothPass standing{path, 1, 0, 1, {0, 1}, 0, 0};
    remove_pass(stock, set.R, Window(stock, set, path[0]), standing);
  }

  // Cubics through the tooth instants, with the slopes of their neighbours.
  void place_substeps(int k) {
    const int last = pose_count - 1;
    for (int a = 0; a < 3; ++a) {
      const double p1 = path[k - 1][a], p2 = path[k][a];
      const double p0 = k > 1 ? path[k - 2][a] : 2 * p1 - p2;
      const double p3 = k < last ? path[k + 1][a] : 2 * p2 - p1;
      const double rise = p2 - p1, start = 0.5 * (p2 - p0), stop = 0.5 * (p3 - p1);
      const auto at = [&](double t) {
        const double bend = 3 * rise - 2 * start - stop + t * (start + stop - 2 * rise);
        return p1 + t * (start + t * bend);
      };
      for (int s = 0; s < set.substeps; ++s) {
        middles[s][a] = at((s + 0.5) / set.substeps);
        next_ends[s][a] = at((s + 1.0) / set.substeps);
      }
    }
  }

  // Enter the poses of the last period, and its pass where it is far enough on.
  void enqueue(int row) {
    const Vec3& pose = path[row];
    const double x = pose[0] - last_tip[0], y = pose[1] - last_tip[1];
    travel += norm(pose, last_tip), last_tip = pose;
    ends.back() = pose;
    std::copy(ends.begin(), ends.end(),
              track.begin() + std::max((row - 1) * set.substeps + 1, 0));
    const double length = std::sqrt(x * x + y * y);
    if (length > kStill) forward[0] = x / length, forward[1] = y / length;
    const double turn = std::atan2(forward[0], forward[1]) * (set.teeth / (2 * kPi));
    passing = turn + std::nearbyint(passing - turn);
    if (passing < -0.5 || passing >= 1.5) passing -= std::floor(passing);
    if (travel - queue.back().travel >= set.lag / kQueue)
      queue.push_back({row, {forward[0], forward[1]}, passing, travel});
  }

  ToothPass tooth_pass(const Waiting& one, int newest) const {
    const int S = set.substeps, start = (one.row - 1) * S, count = pass_length();
    const double steps = one.passing * S;
    int first = start + int(std::floor(steps - set.teeth * S / 2.0));
    first = clamp_index(0, first, int(track.size()) - count);
    return {&track[first], count, first, S, {one.forward[0], one.forward[1]},
            start - first + steps,
            double(clamp_index(0, newest * S - first, count - 1))};
  }

  // Remove up to two passes that the tool has left behind by the lag.
  void remove_lagged(int row) {
    int due = 0;
    for (; due < kRemovals && due < int(queue.size()) - 1; ++due) {
      const Waiting& one = queue[due];
      const bool is_over = row - one.row >= wait();
      const bool is_full = int(queue.size()) >= kQueue || row - one.row >= kHistory;
      const bool is_late = due == 0 && is_full;
      if (!(travel - one.travel >= set.lag && is_over) && !is_late) break;
      if (due == 1) {
        const Vec3 a = tooth_pass(queue[0], row).center();
        const Vec3 b = tooth_pass(one, row).center();
        double apart = 0;
        for (int i = 0; i < 3; ++i) apart = std::max(apart, std::abs(b[i] - a[i]));
        if (apart > set.slack) break;
      }
    }
    if (due == 0) return;
    const Window window(stock, set, tooth_pass(queue[0], row).center());
    for (int i = 0; i < due; ++i)
      volume[queue[i].row] +=
          remove_pass(stock, set.R, window, tooth_pass(queue[i], row));
    queue.erase(queue.begin(), queue.begin() + due);
  }

  // Remove all that waits, and the teeth that go around after the last pose.
  void finish() {
    const int last = pose_count - 1;
    enqueue(last);
    for (int i = 0; i <= wait(); ++i)
      queue.push_back({last + i, {forward[0], forward[1]}, passing, travel});
    for (const Waiting& one : queue) {
      const ToothPass pass = tooth_pass(one, last);
      volume[std::min(one.row, last)] +=
          remove_pass(stock, set.R, Window(stock, set, pass.center()), pass);
    }
  }

  // The newest poses in the queue at given distances behind the tool.
  void find_thinned() {
    thinned.clear();
    for (double share : kThinned) {
      int slot = int(queue.size()) - 1;
      while (slot > 0 && travel - queue[slot].travel < share * set.lag) --slot;
      thinned.push_back(track[queue[slot].row * set.substeps]);
    }
  }

  // Look up the tooth ahead at every angle of a sub-step.
  void look(int s) {
    const Vec3 &tip = middles[s], &before = recent[0][s];
    const double x = tip[0] - before[0], y = tip[1] - before[1];
    for (int i = s * set.per_substep; i < (s + 1) * set.per_substep; ++i) {
      Sample& sample = samples[i];
      double sin = set.sin[i], cos = set.cos[i], lead = lead_of(x, y, sin, cos);
      // Of two opposite teeth the one ahead.
      if (lead < 0) sin = -sin, cos = -cos, lead = -lead;
      sample.sin = sin, sample.cos = cos, sample.fade = faded(lead / set.angle_step);
      const double chip = clamp(0, circle_chip(set.R, -x, -y, sin, cos, 0, 0), set.R);
      const double R = set.R, way = set.angle_step * R;
      const Rim rim{{tip[0] + R * sin, tip[1] + R * cos, tip[2]},
                    {way * cos, -way * sin},
                    {-chip * sin, -chip * cos}};
      look_up(stock, set, rim, sample.discs.data());
    }
  }

  // Add the forces at the angles of a sub-step: chips between circles, then the law.
  void push(int s, Vec3& sum) const {
    const Vec3& tip = middles[s];
    const double x = tip[0] - recent[0][s][0], y = tip[1] - recent[0][s][1];
    const double feed = std::hypot(x, y), way = std::max(feed, kStill);
    const double whole = std::max(norm(recent[0][s], tip), kStill);
    // A side that only moves along itself, as in a plunge, touches nothing.
    const double moving = feed * feed / (feed * feed + kStill * kStill) *
                          hat_integral(2 * clamp(0, feed / whole / kAside, 1) - 1);
    // Poses before the last one, their offset and way from here.
    std::vector<Vec3> older = {recent[1][s]};
    older.insert(older.end(), thinned.begin(), thinned.end());
    std::vector<double> left(older.size()), ways;
    for (Vec3& old : older) {
      ways.push_back(std::max(std::hypot(old[0] - tip[0], old[1] - tip[1]), kStill));
      for (int a = 0; a < 3; ++a) old[a] -= tip[a];
    }
    for (int i = s * set.per_substep; i < (s + 1) * set.per_substep; ++i) {
      const Sample& sample = samples[i];
      if (!sample.is_met()) continue;
      const double sin = sample.sin, cos = sample.cos;
      // Two teeth; when older circles were swept is not known.
      const double newest = circle_chip(set.R, -x, -y, sin, cos, 0, 1 / kPi);
      for (size_t c = 0; c < older.size(); ++c)
        left[c] = circle_chip(set.R, older[c][0], older[c][1], sin, cos, set.diameter,
                              c == 0 ? 0.5 / kPi : 0);
      const double lead = lead_of(x, y, sin, cos);
      const TakenOver over(lead, set.angle_step, feed / set.diameter);
      for (int e = 0; e < set.discs; ++e) {
        const double lower = set.height * e;
        double chip = newest, per_way = newest / way;
        for (size_t c = 0; c < older.size(); ++c) {
          // What lies below an older pose it did not thin.
          const double above = lower + set.height - older[c][2];
          const double share = clamp(0, above / set.height, 1);
          chip -= share * std::max(chip - left[c], 0.0);
          per_way -= share * std::max(per_way - left[c] / ways[c], 0.0);
        }
        const double touch =
            moving * hat_integral(per_way / set.angle_step) * over.contact;
        const double h =
            clamp(0, chip * over.chip, set.R) * sample.discs[e].chip_share;
        const double width = clamp(0, set.flute_length - lower, set.height) *
                             sample.fade * sample.discs[e].occupancy;
        const double F_t = width * (set.K[0] * h + set.K[3] * touch);
        const double F_r = width * (set.K[1] * h + set.K[4] * touch);
        sum[0] += -F_t * cos - F_r * sin;
        sum[1] += F_t * sin - F_r * cos;
        sum[2] += width * (set.K[2] * h + set.K[5] * touch);
      }
    }
  }
};

void write(std::ofstream& out, const double* values, size_t count) {
  out.write(reinterpret_cast<const char*>(values), count * sizeof(double));
}

void write_result(std::ofstream& out, const Process& process) {
  write(out, process.force[0].data(), 3 * process.force.size());
  write(out, process.volume.data(), process.volume.size());
  for (const Rays& rays : process.stock.families) {
    for (size_t i = 0; i < rays.ends.size(); i += 2 * rays.slots) {
      double length = 0;
      for (int m = 0; m < rays.slots; ++m)
        length += std::max(rays.ends[i + rays.slots + m] - rays.ends[i + m], 0.0);
      write(out, &length, 1);
    }
  }
}

int main(int argc, char** argv) try {
  if (argc != 4) throw std::runtime_error("usage: process_step INPUT OUTPUT PARTS");
  const Input in(argv[1]);
  const Settings settings(in);
  const Stock raw(in);
  const int segments = in.count("segment_count"), poses = in.count("pose_count");
  const std::vector<double>& numbers = in.of("path");
  std::vector<Vec3> path(size_t(segments) * poses);
  if (numbers.size() != 3 * path.size()) throw std::runtime_error("wrong size of path");
  for (size_t i = 0; i < numbers.size(); ++i) path[i / 3][i % 3] = numbers[i];
  double seconds = 0;
  for (const bool is_timed : {false, true}) {
    std::ofstream out(argv[2], std::ios::binary);
    for (int i = 0; i < segments; ++i) {
      const std::clock_t start = std::clock();
      Process process(settings, raw, &path[size_t(i) * poses], poses);
      process.run(std::stoi(argv[3]));
      if (is_timed) seconds += double(std::clock() - start) / CLOCKS_PER_SEC;
      write_result(out, process);
    }
  }
  std::printf("%.9f\n", seconds);
} catch (const std::exception& error) {
  std::cerr << "process_step: " << error.what() << "\n";
  return 1;
}
