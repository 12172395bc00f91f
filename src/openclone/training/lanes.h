/* Numbers of sixteen robots at once: vectors, rotations, and what lanes.c keeps. */

#pragma once
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
  for (int l = 0; l < LANES; l++) x[l] = __builtin_sqrtf(x[l]);
  return x;
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
