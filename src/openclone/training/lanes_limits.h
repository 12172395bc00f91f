/* What pushes back: joints at their limits, the ground under the soles.

   Soft constraints as MuJoCo has them, solved by passes of Gauss-Seidel. lanes.c includes
   it after `solve`. */

static inline lane impedance(const Model *model, lane gap) {
  lane x = smallest(largest(gap, -gap) / model->imp_width, splat(1));
  lane y = pick(x < 0.5f, 2 * x * x, 1 - 2 * (1 - x) * (1 - x));
  return model->imp_start + y * (model->imp_end - model->imp_start);
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

/* The corners of the soles: each has four edges of its friction pyramid. */
typedef struct {
  lane at[CONTACTS][3], gap[CONTACTS];
  lane response[LEG][LEG]; /* of the feet's accelerations to wrenches on them */
  lane feet[LEG];          /* the feet's accelerations, turns first */
  lane column[CONTACTS][3][LEG]; /* of all feet's to a push along x, y or z */
  lane block[CONTACTS][3][3];    /* of the corner's own to that push */
  lane wanted[CONTACTS][3], soft[CONTACTS];
} Soles;

/* Where the corners are; whether any of them touches the ground. */
static int find_corners(const Model *model, const Robots *robots, const Work *w, Soles *soles) {
  mask near = (mask)splat(0);
  for (int c = 0; c < CONTACTS; c++) {
    int b = model->foot[c / CORNERS];
    lane *at = soles->at[c];
    turn_fixed(at, w->axes[b], model->corner[c]);
    for (int i = 0; i < 3; i++) at[i] += w->at[b][i];
    soles->gap[c] = at[2] + robots->qpos[2] - model->corner_radius;
    at[2] = 0.5f * soles->gap[c] - robots->qpos[2];
    near |= soles->gap[c] < 0;
  }
  return any(near);
}

/* A = J M^-1 J' of the feet, and how they accelerate without the ground. */
static void feet_response(const Model *model, const Work *w, int path[DOFS][PATH], Soles *soles) {
  lane half[LEG][LEG], scaled[LEG][LEG];
  for (int i = 0; i < LEG; i++) {
    const int *chain = path[5 + model->foot[i / 6]];
    lane *y = half[i], sum = splat(0);
    for (int d = 0; d < LEG; d++) {
      y[d] = w->s[chain[d]][i % 6];
      sum += y[d] * w->accel[chain[d]];
    }
    soles->feet[i] = sum;
    for (int d = LEG - 1; d > 0; d--)
      for (int e = 0; e < d; e++) y[e] -= w->mass[chain[d]][e] * y[d];
    for (int d = 0; d < LEG; d++) scaled[i][d] = y[d] * w->mass[chain[d]][d];
  }
  for (int i = 0; i < LEG; i++)
    for (int k = 0; k <= i; k++) {
      /* Two feet share the root alone. */
      int shared = i / 6 == k / 6 ? LEG : ROOT;
      lane sum = splat(0);
      for (int d = 0; d < shared; d++) sum += half[i][d] * scaled[k][d];
      soles->response[i][k] = soles->response[k][i] = sum;
    }
}

/* The acceleration at ``r`` of a body that accelerates by ``a``, turns first. */
static inline void point_accel(lane *o, const lane *a, const lane *r) {
  o[0] = a[3] + r[2] * a[1] - r[1] * a[2];
  o[1] = a[4] + r[0] * a[2] - r[2] * a[0];
  o[2] = a[5] + r[1] * a[0] - r[0] * a[1];
}

/* Adds what pushes along x, y and z at corner c do to the feet. */
static inline void push_feet(Soles *soles, int c, const lane *push) {
  for (int i = 0; i < LEG; i++)
    for (int k = 0; k < 3; k++) soles->feet[i] += soles->column[c][k][i] * push[k];
}

/* The push of a pyramid's edges: two along x, two along y. */
static inline void edges_to_push(lane *push, const lane *edge, lane mu) {
  push[0] = mu * (edge[0] - edge[1]);
  push[1] = mu * (edge[2] - edge[3]);
  push[2] = edge[0] + edge[1] + edge[2] + edge[3];
}

/* MuJoCo's soft constraint of every corner; forces begin with the last step's. */
static void prepare_corners(const Model *model, Robots *robots, const Work *w, Soles *soles) {
  lane mu = robots->friction;
  for (int c = 0; c < CONTACTS; c++) {
    int f = c / CORNERS, b = model->foot[f];
    const lane *r = soles->at[c];
    for (int i = 0; i < LEG; i++) {
      lane moved[3];
      point_accel(moved, soles->response[i] + 6 * f, r);
      for (int k = 0; k < 3; k++) soles->column[c][k][i] = moved[k];
    }
    for (int k = 0; k < 3; k++) {
      lane moved[3];
      point_accel(moved, soles->column[c][k] + 6 * f, r);
      for (int i = 0; i < 3; i++) soles->block[c][i][k] = moved[i];
    }
    lane imp = impedance(model, soles->gap[c]), rate[3];
    cross(rate, w->v[b], r);
    for (int k = 0; k < 3; k++) soles->wanted[c][k] = -model->damping * (w->v[b][3 + k] + rate[k]);
    soles->wanted[c][2] -= model->stiffness * imp * soles->gap[c];
    lane weight = robots->foot_weight[f] * (1 + mu * mu);
    soles->soft[c] = 2 * mu * mu * weight * (1 - imp) / imp;
    lane *edge = robots->edge[c], push[3];
    for (int e = 0; e < 4; e++) edge[e] = pick(soles->gap[c] < 0, edge[e], splat(0));
    edges_to_push(push, edge, mu);
    push_feet(soles, c, push);
  }
}

/* One pass of Gauss-Seidel over the edges of corner c; the largest change, N. */
static lane relax_corner(Soles *soles, int c, lane *edge, lane mu) {
  lane rest[3], change[3] = {splat(0), splat(0), splat(0)}, most = splat(0);
  const lane(*block)[3] = soles->block[c];
  point_accel(rest, soles->feet + 6 * (c / CORNERS), soles->at[c]);
  for (int k = 0; k < 3; k++) rest[k] -= soles->wanted[c][k];
  for (int e = 0; e < 4; e++) {
    int t = e / 2;
    lane m = e % 2 ? -mu : mu, soft = soles->soft[c];
    lane slope = block[2][2] + 2 * m * block[2][t] + m * m * block[t][t] + soft;
    lane next = edge[e] - (rest[2] + m * rest[t] + soft * edge[e]) / slope;
    next = pick(soles->gap[c] < 0, largest(next, splat(0)), splat(0));
    lane d = next - edge[e];
    edge[e] = next;
    most = largest(most, largest(d, -d));
    change[2] += d;
    change[t] += m * d;
    for (int k = 0; k < 3; k++) rest[k] += d * (block[k][2] + m * block[k][t]);
  }
  push_feet(soles, c, change);
  return most;
}

/* The ground's wrench on a foot, moments first. */
static void foot_wrench(const Robots *robots, const Soles *soles, int f, lane *wrench) {
  for (int k = 0; k < 6; k++) wrench[k] = splat(0);
  for (int c = CORNERS * f; c < CORNERS * (f + 1); c++) {
    lane push[3], moment[3];
    edges_to_push(push, robots->edge[c], robots->friction);
    cross(moment, soles->at[c], push);
    for (int k = 0; k < 3; k++) {
      wrench[k] += moment[k];
      wrench[3 + k] += push[k];
    }
  }
}

/* Forces of the ground on the soles. */
static void contacts(const Model *model, Robots *robots, Work *w, int path[DOFS][PATH]) {
  Soles soles;
  if (!find_corners(model, robots, w, &soles)) {
    for (int f = 0; f < FEET; f++)
      for (int i = 0; i < 3; i++) w->foot_force[f][i] = splat(0);
    for (int c = 0; c < CONTACTS; c++)
      for (int e = 0; e < 4; e++) robots->edge[c][e] = splat(0);
    return;
  }
  feet_response(model, w, path, &soles);
  prepare_corners(model, robots, w, &soles);
  for (int sweep = 0; sweep < model->sweeps; sweep++) {
    lane most = splat(0);
    for (int c = 0; c < CONTACTS; c++)
      most = largest(most, relax_corner(&soles, c, robots->edge[c], robots->friction));
    if (!any(most > model->enough)) break;
  }
  for (int f = 0; f < FEET; f++) {
    const int *chain = path[5 + model->foot[f]];
    lane wrench[6];
    foot_wrench(robots, &soles, f, wrench);
    for (int k = 0; k < 3; k++) w->foot_force[f][k] = wrench[3 + k];
    for (int d = 0; d < LEG; d++) w->applied[chain[d]] += power(w->s[chain[d]], wrench);
  }
}
