/* Rigid-body dynamics of one G1 in each of 16 lanes of a vector register.

   The same equations as MuJoCo's, in single precision: composite inertias, recursive
   Newton-Euler, the factorization M = L'DL along the kinematic tree, soft contacts with
   pyramidal friction, implicit damping of the motors. All vectors stand in world axes;
   moments, and velocities of rotation, refer to the root's position. */

#include <stdint.h>

#define LANES 16
#define BODIES 30
#define JOINTS 29
#define ROOT 6 /* degrees of freedom of the root: 3 translations, 3 turns */
#define DOFS (ROOT + JOINTS)
#define PATH 16 /* most degrees of freedom between the ground and a body */
#define FEET 2
#define LEG 12 /* of a foot */
#define CORNERS 4
#define CONTACTS (FEET * CORNERS)
#define MAX_SPHERES 40
#define SENSORS 14

typedef float lane __attribute__((vector_size(4 * LANES)));
typedef int32_t mask __attribute__((vector_size(4 * LANES)));

/* What all robots share. */
typedef struct {
  int32_t parent[BODIES], axis[BODIES], turned[BODIES]; /* turned: quat matters */
  int32_t foot[FEET], seen[SENSORS], num_spheres, sphere_body[MAX_SPHERES];
  float position[BODIES][3], quat[BODIES][4];
  float armature[JOINTS], lower[JOINTS], upper[JOINTS], max_torque[JOINTS];
  float corner[CONTACTS][3], corner_radius;
  float sphere[MAX_SPHERES][3], sphere_radius[MAX_SPHERES];
  float imu[3];
  float timestep, gravity, stiffness, damping, imp_start, imp_end, imp_width;
  float enough; /* N: contacts are solved when no force changes by more */
  int32_t sweeps; /* at most */
} Model;

/* 16 robots: what distinguishes them, and their state. */
typedef struct {
  lane mass[BODIES], com[BODIES][3], inertia[BODIES][6];
  lane kp[JOINTS], kd[JOINTS], friction;
  lane foot_weight[FEET], sphere_weight[MAX_SPHERES], joint_weight[JOINTS];
  lane qpos[7 + JOINTS], qvel[DOFS], edge[CONTACTS][4];
} Robots;

typedef struct {
  lane quat[BODIES][4], axes[BODIES][9], at[BODIES][3];
  lane s[DOFS][6];
  lane v[BODIES][6];
  lane m[BODIES], h[BODIES][3], inertia[BODIES][6];
  lane force[BODIES][6];
  lane mass[DOFS][PATH], damped[DOFS][PATH];
  lane bias[DOFS], applied[DOFS], torque[JOINTS], accel[DOFS];
  lane foot_force[FEET][3];
} Work;

static inline lane splat(float x) { return x - (lane){}; }
static inline lane pick(mask m, lane a, lane b) {
  return (lane)((m & (mask)a) | (~m & (mask)b));
}
static inline lane largest(lane a, lane b) { return pick(a > b, a, b); }
static inline lane smallest(lane a, lane b) { return pick(a < b, a, b); }
static inline int any(mask m) {
  int found = 0;
  for (int l = 0; l < LANES; l++) found |= m[l];
  return found;
}
static inline lane root_of(lane x) {
  lane y;
  for (int l = 0; l < LANES; l++) y[l] = __builtin_sqrtf(x[l]);
  return y;
}
static inline lane dot(const lane *a, const lane *b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
static inline void cross(lane *o, const lane *a, const lane *b) {
  lane x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2];
  o[2] = a[0] * b[1] - a[1] * b[0];
  o[0] = x;
  o[1] = y;
}
/* o = R a, R row by row. */
static inline void turn(lane *o, const lane *r, const lane *a) {
  for (int i = 0; i < 3; i++) o[i] = dot(r + 3 * i, a);
}
static inline void turn_fixed(lane *o, const lane *r, const float *a) {
  for (int i = 0; i < 3; i++) o[i] = r[3 * i] * a[0] + r[3 * i + 1] * a[1] + r[3 * i + 2] * a[2];
}
static inline void symmetric(lane *o, const lane *i, const lane *a) {
  /* xx yy zz xy xz yz */
  o[0] = i[0] * a[0] + i[3] * a[1] + i[4] * a[2];
  o[1] = i[3] * a[0] + i[1] * a[1] + i[5] * a[2];
  o[2] = i[4] * a[0] + i[5] * a[1] + i[2] * a[2];
}
/* Sine and cosine for |x| up to 2. */
static inline void sincos_of(lane x, lane *s, lane *c) {
  lane y = x * x;
  *s = x * (1 + y * (-1.f / 6 + y * (1.f / 120 + y * (-1.f / 5040 + y * (1.f / 362880 - y * (1.f / 39916800 - y * (1.f / 6227020800.f)))))));
  *c = 1 + y * (-0.5f + y * (1.f / 24 + y * (-1.f / 720 + y * (1.f / 40320 - y * (1.f / 3628800 - y * (1.f / 479001600 - y * (1.f / 87178291200.f)))))));
}
static inline void to_axes(lane *r, const lane *q) {
  lane w = q[0], x = q[1], y = q[2], z = q[3];
  r[0] = 1 - 2 * (y * y + z * z); r[1] = 2 * (x * y - w * z); r[2] = 2 * (x * z + w * y);
  r[3] = 2 * (x * y + w * z); r[4] = 1 - 2 * (x * x + z * z); r[5] = 2 * (y * z - w * x);
  r[6] = 2 * (x * z - w * y); r[7] = 2 * (y * z + w * x); r[8] = 1 - 2 * (x * x + y * y);
}
static inline void product(lane *o, const lane *a, const lane *b) {
  lane w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  lane x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
  lane y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
  o[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
  o[0] = w; o[1] = x; o[2] = y;
}

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

static inline lane impedance(const Model *model, lane gap) {
  lane x = smallest(largest(gap, -gap) / model->imp_width, splat(1));
  lane y = pick(x < 0.5f, 2 * x * x, 1 - 2 * (1 - x) * (1 - x));
  return model->imp_start + y * (model->imp_end - model->imp_start);
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

/* Joints at their limits: all of them together, before the ground pushes. */
static void limits(const Model *model, const Robots *robots, Work *w, const int *depth, int path[DOFS][PATH]) {
  int chosen[JOINTS], count = 0;
  lane side[JOINTS], wanted[JOINTS], soft[JOINTS], push[JOINTS], column[JOINTS][DOFS];
  mask beyond[JOINTS];
  for (int j = 0; j < JOINTS; j++) {
    lane q = robots->qpos[7 + j], low = q - model->lower[j], high = model->upper[j] - q;
    lane gap = smallest(low, high);
    if (!any(gap < 0)) continue;
    lane imp = impedance(model, gap);
    chosen[count] = j;
    beyond[count] = gap < 0;
    side[count] = pick(low < 0, splat(1), splat(-1));
    wanted[count] = -model->damping * side[count] * robots->qvel[ROOT + j] - model->stiffness * imp * gap;
    soft[count] = robots->joint_weight[j] * (1 - imp) / imp;
    push[count] = splat(0);
    for (int k = 0; k < DOFS; k++) column[count][k] = splat(k == ROOT + j);
    solve(w->mass, depth, path, column[count]);
    count++;
  }
  for (int sweep = 0; sweep < 5; sweep++)
    for (int i = 0; i < count; i++) {
      int j = ROOT + chosen[i];
      lane missing = wanted[i] - side[i] * w->accel[j] - soft[i] * push[i];
      lane next = pick(beyond[i], largest(push[i] + missing / (column[i][j] + soft[i]), splat(0)), splat(0));
      lane change = side[i] * (next - push[i]);
      push[i] = next;
      for (int k = 0; k < DOFS; k++) w->accel[k] += change * column[i][k];
    }
  for (int i = 0; i < count; i++) w->applied[ROOT + chosen[i]] += side[i] * push[i];
}

/* Forces on the soles: each corner has four edges of its friction pyramid. */
static void contacts(const Model *model, Robots *robots, Work *w, const int *depth, int path[DOFS][PATH]) {
  lane at[CONTACTS][3], gap[CONTACTS];
  mask near = (mask)splat(0);
  for (int c = 0; c < CONTACTS; c++) {
    int b = model->foot[c / CORNERS];
    turn_fixed(at[c], w->axes[b], model->corner[c]);
    for (int i = 0; i < 3; i++) at[c][i] += w->at[b][i];
    gap[c] = at[c][2] + robots->qpos[2] - model->corner_radius;
    at[c][2] = 0.5f * gap[c] - robots->qpos[2];
    near |= gap[c] < 0;
  }
  for (int f = 0; f < FEET; f++)
    for (int i = 0; i < 3; i++) w->foot_force[f][i] = splat(0);
  if (!any(near)) {
    for (int c = 0; c < CONTACTS; c++)
      for (int e = 0; e < 4; e++) robots->edge[c][e] = splat(0);
    return;
  }
  /* How the feet accelerate under wrenches on them: A = J M^-1 J'. */
  lane half[FEET][6][LEG], scaled[FEET][6][LEG], response[LEG][LEG], x[LEG];
  for (int f = 0; f < FEET; f++) {
    int last = 5 + model->foot[f];
    for (int r = 0; r < 6; r++) {
      lane *y = half[f][r];
      for (int d = 0; d < LEG; d++) y[d] = w->s[path[last][d]][r];
      for (int d = LEG - 1; d > 0; d--) {
        const lane *row = w->mass[path[last][d]];
        for (int e = 0; e < d; e++) y[e] -= row[e] * y[d];
      }
      for (int d = 0; d < LEG; d++) scaled[f][r][d] = y[d] * w->mass[path[last][d]][d];
      lane sum = splat(0);
      for (int d = 0; d < LEG; d++) sum += w->s[path[last][d]][r] * w->accel[path[last][d]];
      x[6 * f + r] = sum;
    }
  }
  for (int i = 0; i < LEG; i++)
    for (int k = 0; k <= i; k++) {
      int shared = i / 6 == k / 6 ? LEG : ROOT;
      const lane *y = half[i / 6][i % 6], *z = scaled[k / 6][k % 6];
      lane sum = splat(0);
      for (int d = 0; d < shared; d++) sum += y[d] * z[d];
      response[i][k] = response[k][i] = sum;
    }
  lane column[CONTACTS][3][LEG], block[CONTACTS][3][3], wanted[CONTACTS][3], soft[CONTACTS];
  lane mu = robots->friction;
  for (int c = 0; c < CONTACTS; c++) {
    int f = c / CORNERS, o = 6 * f, b = model->foot[f];
    const lane *r = at[c];
    for (int i = 0; i < LEG; i++) {
      const lane *a = response[i] + o;
      column[c][0][i] = a[3] + r[2] * a[1] - r[1] * a[2];
      column[c][1][i] = a[4] + r[0] * a[2] - r[2] * a[0];
      column[c][2][i] = a[5] + r[1] * a[0] - r[0] * a[1];
    }
    for (int k = 0; k < 3; k++) {
      const lane *a = column[c][k] + o;
      block[c][0][k] = a[3] + r[2] * a[1] - r[1] * a[2];
      block[c][1][k] = a[4] + r[0] * a[2] - r[2] * a[0];
      block[c][2][k] = a[5] + r[1] * a[0] - r[0] * a[1];
    }
    lane imp = impedance(model, gap[c]), rate[3];
    cross(rate, w->v[b], r);
    for (int k = 0; k < 3; k++) wanted[c][k] = -model->damping * (w->v[b][3 + k] + rate[k]);
    wanted[c][2] -= model->stiffness * imp * gap[c];
    /* MuJoCo's regularization of a friction pyramid. */
    lane weight = robots->foot_weight[f] * (1 + mu * mu);
    soft[c] = 2 * mu * mu * weight * (1 - imp) / imp;
    /* Forces of the step before. */
    lane *g = robots->edge[c];
    for (int e = 0; e < 4; e++) g[e] = pick(gap[c] < 0, g[e], splat(0));
    lane fx = mu * (g[0] - g[1]), fy = mu * (g[2] - g[3]), fz = g[0] + g[1] + g[2] + g[3];
    for (int i = 0; i < LEG; i++) x[i] += column[c][0][i] * fx + column[c][1][i] * fy + column[c][2][i] * fz;
  }
  for (int sweep = 0; sweep < model->sweeps; sweep++) {
    lane largest_change = splat(0);
    for (int c = 0; c < CONTACTS; c++) {
      const lane *r = at[c], *a = x + 6 * (c / CORNERS);
      lane *g = robots->edge[c], change[3] = {splat(0), splat(0), splat(0)};
      lane rest[3] = {
          a[3] + r[2] * a[1] - r[1] * a[2] - wanted[c][0],
          a[4] + r[0] * a[2] - r[2] * a[0] - wanted[c][1],
          a[5] + r[1] * a[0] - r[0] * a[1] - wanted[c][2],
      };
      for (int e = 0; e < 4; e++) {
        int t = e / 2;
        lane m = e % 2 ? -mu : mu;
        lane slope = block[c][2][2] + 2 * m * block[c][2][t] + m * m * block[c][t][t] + soft[c];
        lane now = rest[2] + m * rest[t] + soft[c] * g[e];
        lane next = pick(gap[c] < 0, largest(g[e] - now / slope, splat(0)), splat(0));
        lane d = next - g[e];
        g[e] = next;
        largest_change = largest(largest_change, largest(d, -d));
        change[2] += d;
        change[t] += m * d;
        for (int k = 0; k < 3; k++) rest[k] += d * (block[c][k][2] + m * block[c][k][t]);
      }
      for (int i = 0; i < LEG; i++)
        x[i] += column[c][0][i] * change[0] + column[c][1][i] * change[1] + column[c][2][i] * change[2];
    }
    if (!any(largest_change > model->enough)) break;
  }
  for (int f = 0; f < FEET; f++) {
    lane wrench[6], moment[3];
    for (int k = 0; k < 6; k++) wrench[k] = splat(0);
    for (int c = CORNERS * f; c < CORNERS * (f + 1); c++) {
      const lane *g = robots->edge[c];
      lane push[3] = {mu * (g[0] - g[1]), mu * (g[2] - g[3]), g[0] + g[1] + g[2] + g[3]};
      cross(moment, at[c], push);
      for (int k = 0; k < 3; k++) {
        wrench[k] += moment[k];
        wrench[3 + k] += push[k];
      }
    }
    for (int k = 0; k < 3; k++) w->foot_force[f][k] = wrench[3 + k];
    int last = 5 + model->foot[f];
    for (int d = 0; d < LEG; d++) w->applied[path[last][d]] += power(w->s[path[last][d]], wrench);
  }
}

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
  contacts(model, robots, w, depth, path);
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
