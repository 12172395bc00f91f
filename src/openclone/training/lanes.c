/* Rigid-body dynamics of one G1 in each of 16 lanes of a vector register.

   The same equations as MuJoCo's, in single precision: composite inertias, recursive
   Newton-Euler, the factorization M = L'DL along the kinematic tree, soft contacts with
   pyramidal friction, implicit damping of the motors. All vectors stand in world axes;
   moments, and velocities of rotation, refer to the root's position. */

#include "lanes.h"

/* Places, axes and velocities of the bodies; what a unit speed of each joint moves. */
static void kinematics(const Model *model, const Robots *robots, Work *w) {
  const lane *q = robots->qpos, *v = robots->qvel;
  lane length = 1 / root_of(q[3] * q[3] + q[4] * q[4] + q[5] * q[5] + q[6] * q[6]);
  for (int i = 0; i < 4; i++) w->quat[0][i] = q[3 + i] * length;
  to_axes(w->axes[0], w->quat[0]);
  for (int i = 0; i < 3; i++) {
    w->at[0][i] = splat(0);
    for (int k = 0; k < 6; k++) w->s[i][k] = splat(k == 3 + i);
    for (int k = 0; k < 3; k++) {
      w->s[3 + i][k] = w->axes[0][3 * k + i];
      w->s[3 + i][3 + k] = splat(0);
    }
  }
  turn(w->v[0], w->axes[0], v + 3);
  for (int i = 0; i < 3; i++) w->v[0][3 + i] = v[i];
  for (int b = 1; b < BODIES; b++) {
    int p = model->parent[b], axis = model->axis[b];
    lane moved[3], base[4];
    turn_fixed(moved, w->axes[p], model->position[b]);
    for (int i = 0; i < 3; i++) w->at[b][i] = w->at[p][i] + moved[i];
    for (int i = 0; i < 4; i++) base[i] = w->quat[p][i];
    if (model->turned[b]) {
      lane fixed[4];
      for (int i = 0; i < 4; i++) fixed[i] = splat(model->quat[b][i]);
      product(base, base, fixed);
    }
    lane half[4] = {splat(0), splat(0), splat(0), splat(0)}, s, c;
    sincos_of(0.5f * q[6 + b], &s, &c);
    half[0] = c;
    half[1 + axis] = s;
    product(w->quat[b], base, half);
    to_axes(w->axes[b], w->quat[b]);
    lane *column = w->s[5 + b];
    for (int k = 0; k < 3; k++) column[k] = w->axes[b][3 * k + axis];
    cross(column + 3, w->at[b], column);
    for (int k = 0; k < 6; k++) w->v[b][k] = w->v[p][k] + column[k] * v[5 + b];
  }
}

/* f = I a, of a body. */
static inline void momentum(lane *o, const Work *w, int b, const lane *a) {
  lane turned[3], moved[3];
  symmetric(o, w->inertia[b], a);
  cross(turned, w->h[b], a + 3);
  cross(moved, a, w->h[b]);
  for (int i = 0; i < 3; i++) {
    o[i] += turned[i];
    o[3 + i] = w->m[b] * a[3 + i] + moved[i];
  }
}

/* Push of the ground against parts that are not feet, without friction. */
static void touch(const Model *model, const Robots *robots, Work *w) {
  for (int k = 0; k < model->num_spheres; k++) {
    int b = model->sphere_body[k];
    lane at[3], rate[3];
    turn_fixed(at, w->axes[b], model->sphere[k]);
    for (int i = 0; i < 3; i++) at[i] += w->at[b][i];
    lane gap = at[2] + robots->qpos[2] - model->sphere_radius[k];
    if (!any(gap < 0)) continue;
    cross(rate, w->v[b], at);
    lane speed = w->v[b][5] + rate[2];
    lane push = model->gravity - model->damping * speed - model->stiffness * model->imp_end * gap;
    push = push * model->imp_end / robots->sphere_weight[k];
    push = pick(gap < 0, largest(push, splat(0)), splat(0));
    w->force[b][0] -= at[1] * push;
    w->force[b][1] += at[0] * push;
    w->force[b][5] -= push;
  }
}

/* Inertias; forces that keep all accelerations at zero: gravity, turning, ground. */
static void inertia(const Model *model, const Robots *robots, Work *w) {
  lane a[BODIES][6];
  for (int b = 0; b < BODIES; b++) {
    const lane *r = w->axes[b], *i = robots->inertia[b], m = robots->mass[b];
    lane c[3], half[9];
    turn(c, r, robots->com[b]);
    for (int k = 0; k < 3; k++) c[k] += w->at[b][k];
    for (int row = 0; row < 3; row++) symmetric(half + 3 * row, i, r + 3 * row);
    w->m[b] = m;
    for (int k = 0; k < 3; k++) w->h[b][k] = m * c[k];
    lane square = m * dot(c, c);
    w->inertia[b][0] = dot(half, r) + square - m * c[0] * c[0];
    w->inertia[b][1] = dot(half + 3, r + 3) + square - m * c[1] * c[1];
    w->inertia[b][2] = dot(half + 6, r + 6) + square - m * c[2] * c[2];
    w->inertia[b][3] = dot(half, r + 3) - m * c[0] * c[1];
    w->inertia[b][4] = dot(half, r + 6) - m * c[0] * c[2];
    w->inertia[b][5] = dot(half + 3, r + 6) - m * c[1] * c[2];
    if (b == 0) {
      for (int k = 0; k < 3; k++) a[0][k] = splat(0);
      cross(a[0] + 3, w->v[0] + 3, w->v[0]);
      a[0][5] += model->gravity;
    } else {
      int p = model->parent[b];
      const lane *s = w->s[5 + b], *v = w->v[b];
      lane spun[3], swung[3], moved[3], rate = robots->qvel[5 + b];
      cross(spun, v, s);
      cross(swung, v, s + 3);
      cross(moved, v + 3, s);
      for (int k = 0; k < 3; k++) {
        a[b][k] = a[p][k] + spun[k] * rate;
        a[b][3 + k] = a[p][3 + k] + (swung[k] + moved[k]) * rate;
      }
    }
    lane moving[6], t[3], u[3];
    const lane *v = w->v[b];
    momentum(w->force[b], w, b, a[b]);
    momentum(moving, w, b, v);
    cross(t, v, moving);
    cross(u, v + 3, moving + 3);
    for (int k = 0; k < 3; k++) w->force[b][k] += t[k] + u[k];
    cross(t, v, moving + 3);
    for (int k = 0; k < 3; k++) w->force[b][3 + k] += t[k];
  }
  touch(model, robots, w);
}

static inline lane power(const lane *s, const lane *f) { return dot(s, f) + dot(s + 3, f + 3); }

/* The mass matrix, row by row along the path from the ground, and the bias forces. */
static void mass_matrix(const Model *model, Work *w, const int *depth, int path[DOFS][PATH]) {
  for (int b = BODIES - 1; b >= 1; b--) {
    int p = model->parent[b], j = 5 + b, d = depth[j];
    lane f[6];
    w->bias[j] = power(w->s[j], w->force[b]);
    momentum(f, w, b, w->s[j]);
    for (int k = 0; k < 3; k++) w->mass[j][k] = f[3 + k];
    for (int e = 3; e < d; e++) w->mass[j][e] = power(w->s[path[j][e]], f);
    w->mass[j][d] = power(w->s[j], f) + model->armature[b - 1];
    w->m[p] += w->m[b];
    for (int k = 0; k < 3; k++) w->h[p][k] += w->h[b][k];
    for (int k = 0; k < 6; k++) w->inertia[p][k] += w->inertia[b][k];
    for (int k = 0; k < 6; k++) w->force[p][k] += w->force[b][k];
  }
  for (int j = 0; j < ROOT; j++) {
    lane f[6];
    w->bias[j] = power(w->s[j], w->force[0]);
    momentum(f, w, 0, w->s[j]);
    for (int e = 0; e <= j; e++) w->mass[j][e] = power(w->s[e], f);
  }
}

/* M = L'DL in place; the diagonal holds 1 / D. */
static void factor(lane m[DOFS][PATH], const int *depth, int path[DOFS][PATH]) {
  for (int j = DOFS - 1; j >= 0; j--) {
    int n = depth[j];
    lane inverse = 1 / m[j][n];
    for (int d = n - 1; d >= 0; d--) {
      lane share = m[j][d] * inverse, *row = m[path[j][d]];
      for (int e = 0; e <= d; e++) row[e] -= share * m[j][e];
    }
    for (int d = 0; d < n; d++) m[j][d] *= inverse;
    m[j][n] = inverse;
  }
}

static void solve(lane m[DOFS][PATH], const int *depth, int path[DOFS][PATH], lane *x) {
  for (int j = DOFS - 1; j >= 0; j--)
    for (int d = 0; d < depth[j]; d++) x[path[j][d]] -= m[j][d] * x[j];
  for (int j = 0; j < DOFS; j++) {
    lane sum = x[j] * m[j][depth[j]];
    for (int d = 0; d < depth[j]; d++) sum -= m[j][d] * x[path[j][d]];
    x[j] = sum;
  }
}

/* Torques of the motors; forces that nothing balances. */
static void motors(const Model *model, const Robots *robots, const lane *target, Work *w) {
  for (int j = 0; j < JOINTS; j++) {
    lane t = robots->kp[j] * (target[j] - robots->qpos[7 + j]) - robots->kd[j] * robots->qvel[ROOT + j];
    lane bound = splat(model->max_torque[j]);
    w->torque[j] = largest(smallest(t, bound), -bound);
    w->applied[ROOT + j] = w->torque[j] - w->bias[ROOT + j];
  }
  for (int j = 0; j < ROOT; j++) w->applied[j] = -w->bias[j];
}

#include "lanes_limits.h"

static void integrate(const Model *model, Robots *robots, const lane *accel) {
  lane h = splat(model->timestep), *q = robots->qpos, *v = robots->qvel;
  for (int j = 0; j < DOFS; j++) v[j] += h * accel[j];
  for (int i = 0; i < 3; i++) q[i] += h * v[i];
  for (int j = 0; j < JOINTS; j++) q[7 + j] += h * v[ROOT + j];
  lane size = root_of(dot(v + 3, v + 3) + 1e-20f), s, c, by[4];
  sincos_of(smallest(0.5f * h * size, splat(2)), &s, &c);
  by[0] = c;
  for (int i = 0; i < 3; i++) by[1 + i] = v[3 + i] / size * s;
  product(q + 3, q + 3, by);
  lane length = 1 / root_of(q[3] * q[3] + q[4] * q[4] + q[5] * q[5] + q[6] * q[6]);
  for (int i = 0; i < 4; i++) q[3 + i] *= length;
}

static void paths(const Model *model, int *depth, int path[DOFS][PATH]) {
  for (int j = 0; j < ROOT; j++) {
    depth[j] = j;
    for (int d = 0; d <= j; d++) path[j][d] = d;
  }
  for (int b = 1; b < BODIES; b++) {
    int j = 5 + b, p = model->parent[b] == 0 ? ROOT - 1 : 5 + model->parent[b];
    depth[j] = depth[p] + 1;
    for (int d = 0; d <= depth[p]; d++) path[j][d] = path[p][d];
    path[j][depth[j]] = j;
  }
}

/* Sensors of the 16 robots, one row each: places, turns, velocities, angular velocities
   of the bodies that are seen; torques; forces of the feet on the ground; gyroscope and
   accelerometer. */
static void sense(const Model *model, const Robots *robots, const Work *w, const lane *accel, float *rows, int width) {
  int k = 0;
#define PUT(value) do { lane x_ = (value); for (int l = 0; l < LANES; l++) rows[l * width + k] = x_[l]; k++; } while (0)
  for (int n = 0; n < SENSORS; n++)
    for (int i = 0; i < 3; i++) PUT(w->at[model->seen[n]][i] + robots->qpos[i]);
  for (int n = 0; n < SENSORS; n++)
    for (int i = 0; i < 4; i++) PUT(w->quat[model->seen[n]][i]);
  for (int n = 0; n < SENSORS; n++) {
    int b = model->seen[n];
    lane moved[3];
    cross(moved, w->v[b], w->at[b]);
    for (int i = 0; i < 3; i++) PUT(w->v[b][3 + i] + moved[i]);
  }
  for (int n = 0; n < SENSORS; n++)
    for (int i = 0; i < 3; i++) PUT(w->v[model->seen[n]][i]);
  for (int j = 0; j < JOINTS; j++) PUT(w->torque[j]);
  for (int f = 0; f < FEET; f++)
    for (int i = 0; i < 3; i++) PUT(-w->foot_force[f][i]);
  for (int i = 0; i < 3; i++) PUT(robots->qvel[3 + i]);
  lane arm[3], spin[3], out[3], total[3], turned[3];
  turn_fixed(arm, w->axes[0], model->imu);
  turn(spin, w->axes[0], accel + 3);
  cross(out, w->v[0], arm);
  cross(out, w->v[0], out);
  cross(turned, spin, arm);
  for (int i = 0; i < 3; i++) total[i] = accel[i] + turned[i] + out[i] + (i == 2 ? model->gravity : 0);
  for (int i = 0; i < 3; i++) PUT(w->axes[0][i] * total[0] + w->axes[0][3 + i] * total[1] + w->axes[0][6 + i] * total[2]);
#undef PUT
}

static void one_step(const Model *model, Robots *robots, Work *w, const lane *target, const int *depth, int path[DOFS][PATH], float *sensors, int width, int advance) {
  kinematics(model, robots, w);
  inertia(model, robots, w);
  mass_matrix(model, w, depth, path);
  motors(model, robots, target, w);
  for (int j = 0; j < DOFS; j++)
    for (int d = 0; d <= depth[j]; d++) w->damped[j][d] = w->mass[j][d];
  /* A motor at its limit does not damp. */
  for (int j = 0; j < JOINTS; j++) {
    lane bound = splat(model->max_torque[j]), damps = model->timestep * robots->kd[j];
    mask free = (w->torque[j] < bound) & (w->torque[j] > -bound);
    w->damped[ROOT + j][depth[ROOT + j]] += pick(free, damps, splat(0));
  }
  factor(w->mass, depth, path);
  for (int j = 0; j < DOFS; j++) w->accel[j] = w->applied[j];
  solve(w->mass, depth, path, w->accel);
  limits(model, robots, w, depth, path);
  contacts(model, robots, w, path);
  if (sensors) {
    lane accel[DOFS];
    for (int j = 0; j < DOFS; j++) accel[j] = w->applied[j];
    solve(w->mass, depth, path, accel);
    sense(model, robots, w, accel, sensors, width);
  }
  if (!advance) return;
  factor(w->damped, depth, path);
  for (int j = 0; j < DOFS; j++) w->accel[j] = w->applied[j];
  solve(w->damped, depth, path, w->accel);
  integrate(model, robots, w->accel);
}

/* Advance blocks of 16 robots; ctrl (robots, substeps, 29), sensors (robots, width).
   Like MuJoCo's, sensors tell of the state before the last substep. Without substeps,
   of the state as it is, with motors that want all joints at zero. */
void advance(const Model *model, Robots *robots, int blocks, const float *ctrl, int substeps, float *sensors, int width) {
  int depth[DOFS], path[DOFS][PATH];
  Work work;
  paths(model, depth, path);
  for (int n = 0; n < blocks; n++) {
    float *rows = sensors + (int64_t)n * LANES * width;
    lane target[JOINTS];
    if (substeps == 0) {
      Robots still = robots[n];
      for (int j = 0; j < JOINTS; j++) target[j] = splat(0);
      one_step(model, &still, &work, target, depth, path, rows, width, 0);
    }
    for (int t = 0; t < substeps; t++) {
      for (int j = 0; j < JOINTS; j++)
        for (int l = 0; l < LANES; l++)
          target[j][l] = ctrl[((int64_t)(n * LANES + l) * substeps + t) * JOINTS + j];
      one_step(model, robots + n, &work, target, depth, path, t == substeps - 1 ? rows : 0, width, 1);
    }
  }
}

int64_t model_bytes(void) { return sizeof(Model); }
int64_t robots_bytes(void) { return sizeof(Robots); }
