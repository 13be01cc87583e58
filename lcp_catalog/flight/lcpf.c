/* See lcpf.h. */
#include "lcpf.h"

#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846
#define HEADER 192u
#define TILE 40u
#define POINT 96u
#define NONE 255u
#define DEPENDENT 128u
#define COVER 0.95      /* least share of a pixel's point spread on the patch */
#define REAL 0.7        /* least share of valid pixels under a template */
#define HALVED_FROM 144 /* pixels of templates that are first searched at half resolution */
#define NOWHERE (-2.0f)

const lcpf_law LCPF_LOMMEL_SEELIGER = {0, {0.21, 0.0, 0.0, 0.0, 0.0}};
const lcpf_law LCPF_LUNAR_LAMBERT = {1, {0.048057257303098844, 1.347, 0.0565, -0.053, 0.227}}; /* Yokota et al. 2011 */

/* ---- numbers of the file, whatever the byte order of the machine */
static uint32_t u16(const uint8_t *p) { return (uint32_t)p[0] | (uint32_t)p[1] << 8; }
static uint32_t u32(const uint8_t *p) { return u16(p) | u16(p + 2) << 16; }
static uint64_t u64(const uint8_t *p) { return (uint64_t)u32(p) | (uint64_t)u32(p + 4) << 32; }

static double f32(const uint8_t *p) { uint32_t bits = u32(p); float value; memcpy(&value, &bits, sizeof value); return value; }
static double f64(const uint8_t *p) { uint64_t bits = u64(p); double value; memcpy(&value, &bits, sizeof value); return value; }

static int32_t signed16(const uint8_t *p) { int32_t value = (int32_t)u16(p); return value < 32768 ? value : value - 65536; }

static uint32_t crc32(const uint8_t *p, size_t count) {
    uint32_t table[16], crc = 0xFFFFFFFFu;
    for (uint32_t k = 0; k < 16; k++) {
        uint32_t value = k;
        for (int bit = 0; bit < 4; bit++) value = value >> 1 ^ (value & 1u ? 0xEDB88320u : 0u);
        table[k] = value;
    }
    for (size_t k = 0; k < count; k++) {
        crc ^= p[k];
        crc = crc >> 4 ^ table[crc & 15u];
        crc = crc >> 4 ^ table[crc & 15u];
    }
    return ~crc;
}

static int finite3(const double v[3]) { return isfinite(v[0]) && isfinite(v[1]) && isfinite(v[2]); }
static double dot3(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void turned(const double r[9], const double v[3], double out[3]) {
    for (int k = 0; k < 3; k++) out[k] = dot3(r + 3 * k, v);
}

/* Unit direction from a to b; its length is returned. */
static double towards(const double a[3], const double b[3], double out[3]) {
    for (int k = 0; k < 3; k++) out[k] = b[k] - a[k];
    double length = sqrt(dot3(out, out));
    for (int k = 0; k < 3; k++) out[k] /= length;
    return length;
}

/* ---- the file */
static size_t claims_at(const lcpf_file *f) {
    return POINT + (size_t)f->nodes * f->nodes * (f->albedo ? 3u : 2u);
}

static const uint8_t *point_at(const lcpf_file *f, uint32_t number) { return f->bytes + f->data + f->stride * number; }

static const uint8_t *tile_at(const lcpf_file *f, uint32_t tile) { return f->bytes + f->index + TILE * (size_t)tile; }

int lcpf_open(lcpf_file *f, const uint8_t *b, size_t size) {
    static const uint8_t magic[8] = {0x4C, 0x43, 0x50, 0x46, 0x0D, 0x0A, 0x1A, 0x0A};
    if (size < HEADER) return LCPF_NOT_A_FILE;
    for (int k = 0; k < 8; k++) if (b[k] != magic[k]) return LCPF_NOT_A_FILE;
    if (u32(b + 8) != 1u || u32(b + 12) != HEADER) return LCPF_NOT_A_FILE;
    if (u64(b + 16) != size || crc32(b, HEADER - 4) != u32(b + HEADER - 4)) return LCPF_DAMAGED;
    f->bytes = b, f->size = size;
    f->points = u32(b + 24), f->tiles = u32(b + 28), f->stride = u32(b + 32), f->nodes = u16(b + 36);
    f->scales = u16(b + 38), f->suns = u16(b + 40), f->views = u16(b + 42);
    f->elevations = u16(b + 44), f->azimuths = u16(b + 46), f->frame = u16(b + 48), f->albedo = u16(b + 50);
    f->min_detection = f32(b + 64), f->probability_step = f32(b + 68);
    f->sigma_log_least = f64(b + 72), f->sigma_log_step = f64(b + 80);
    f->triangles = u16(b + 132), f->albedo_sigma = f32(b + 136), f->slope_sigma = f32(b + 140);
    if (f->nodes < 3 || f->nodes % 2 == 0 || f->albedo > 1 || f->frame > 1) return LCPF_DAMAGED;
    if (!f->scales || !f->suns || !f->views || !f->elevations || !f->azimuths) return LCPF_DAMAGED;
    if (f->nodes > LCPF_NODES) return LCPF_TOO_LARGE;
    uint64_t suns = (uint64_t)f->elevations * f->azimuths;
    uint64_t floats = 4u * ((uint64_t)f->elevations + f->azimuths + 3u * f->views + f->scales);
    uint64_t tables = floats + 2u * suns + 3u * f->triangles;
    tables += (8u - tables % 8u) % 8u;
    uint64_t stride = claims_at(f) + 4u * (uint64_t)f->scales * f->suns * f->views;
    stride += (4u - stride % 4u) % 4u;
    uint64_t index = HEADER + tables, data = index + TILE * (uint64_t)f->tiles;
    if (stride != f->stride || data > size || (size - data) / stride < f->points) return LCPF_DAMAGED;
    if (data + stride * f->points != size) return LCPF_DAMAGED;
    f->tables = HEADER, f->index = (size_t)index, f->data = (size_t)data;
    f->numbers = HEADER + (size_t)floats, f->views_at = f->numbers + 2u * (size_t)suns;
    if (crc32(b + f->tables, (size_t)tables) != u32(b + 52)) return LCPF_DAMAGED;
    if (crc32(b + f->index, f->data - f->index) != u32(b + 56)) return LCPF_DAMAGED;
    for (uint32_t k = 0; k < 3 * f->triangles; k++) if (b[f->views_at + k] >= f->views) return LCPF_DAMAGED;
    uint64_t next = 0;
    for (uint32_t t = 0; t < f->tiles; t++) {
        if (u32(tile_at(f, t) + 28) != next) return LCPF_DAMAGED;
        next += u32(tile_at(f, t) + 32);
    }
    return next == f->points ? LCPF_OK : LCPF_DAMAGED;
}

int lcpf_check_tile(const lcpf_file *f, uint32_t tile) {
    if (tile >= f->tiles) return LCPF_ARGUMENT;
    const uint8_t *t = tile_at(f, tile);
    return crc32(point_at(f, u32(t + 28)), f->stride * u32(t + 32)) == u32(t + 36) ? LCPF_OK : LCPF_DAMAGED;
}

int lcpf_check(const lcpf_file *f) {
    for (uint32_t t = 0; t < f->tiles; t++) if (lcpf_check_tile(f, t)) return LCPF_DAMAGED;
    return LCPF_OK;
}

static void load_place(const uint8_t *p, double position[3], double rotation[9]) {
    for (int k = 0; k < 3; k++) position[k] = f64(p + 8 + 8 * k);
    for (int k = 0; k < 9; k++) rotation[k] = f32(p + 32 + 4 * k);
}

int lcpf_load(const lcpf_file *f, uint32_t number, lcpf_point *point) {
    if (number >= f->points) return LCPF_ARGUMENT;
    const uint8_t *p = point_at(f, number);
    uint64_t id = u64(p);
    memcpy(&point->id, &id, sizeof id);
    load_place(p, point->position, point->rotation);
    point->gsd = f32(p + 68), point->elevation_sigma = f32(p + 88);
    point->level = (int32_t)u16(p + 92), point->nodes = (int32_t)f->nodes;
    double middle = f32(p + 72), step = f32(p + 76), grey = f32(p + 80), rise = f32(p + 84);
    if (!isfinite(middle) || !isfinite(step) || !isfinite(grey) || !isfinite(rise)) return LCPF_DAMAGED;
    if (!(point->gsd > 0.0) || !finite3(point->position)) return LCPF_DAMAGED;
    const uint8_t *heights = p + POINT, *albedo = heights + 2 * f->nodes * f->nodes;
    for (uint32_t k = 0; k < f->nodes * f->nodes; k++) {
        int32_t value = f->albedo ? (int32_t)albedo[k] : 0;
        point->height[k] = (float)(middle + step * signed16(heights + 2 * k));
        point->albedo[k] = f->albedo ? (float)(grey + rise * (value < 128 ? value : value - 256)) : 1.0f;
    }
    return LCPF_OK;
}

/* ---- the camera */
static int lens(const double k[5], double x, double y, double out[2]) {
    double r2 = x * x + y * y, radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    for (int i = 1; i <= 16; i++) { /* beyond the fold of the radial polynomial nothing is seen */
        double q = r2 * i / 16.0;
        if (!(1.0 + q * (3.0 * k[0] + q * (5.0 * k[1] + q * 7.0 * k[4])) >= 0.0)) return 0;
    }
    out[0] = x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x);
    out[1] = y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y;
    return 1;
}

int lcpf_project(const lcpf_camera *c, const double position[3], double pixel[2]) {
    double away[3], v[3], out[2];
    for (int k = 0; k < 3; k++) away[k] = position[k] - c->position[k];
    turned(c->rotation, away, v);
    if (!(v[2] > 0.0) || !lens(c->distortion, v[0] / v[2], v[1] / v[2], out)) return 0;
    for (int k = 0; k < 2; k++) pixel[k] = c->principal[k] + c->focal * out[k];
    return fabs(pixel[0]) < 1e6 && fabs(pixel[1]) < 1e6; /* no for NaN */
}

/* Largest tangent of the angle between the axis and the rays of the image's border. */
static double cone(const lcpf_camera *c) {
    double widest = 0.0;
    for (int k = 0; k < 9; k++) {
        double u = ((k % 3) * 0.5 * c->width - 0.5 - c->principal[0]) / c->focal;
        double v = ((k / 3) * 0.5 * c->height - 0.5 - c->principal[1]) / c->focal;
        double x = u, y = v, out[2];
        for (int step = 0; step < 20; step++) {
            if (!lens(c->distortion, x, y, out)) return HUGE_VAL;
            x += u - out[0], y += v - out[1];
        }
        widest = fmax(widest, sqrt(x * x + y * y));
    }
    return 1.05 * widest;
}

static int may_be_seen(const lcpf_camera *c, double slope, const uint8_t *tile) {
    double centre[3], away[3], v[3], radius = f32(tile + 24);
    for (int k = 0; k < 3; k++) centre[k] = f64(tile + 8 * k), away[k] = centre[k] - c->position[k];
    turned(c->rotation, away, v);
    /* distance of the ball's centre outside the cone */
    double outside = (sqrt(v[0] * v[0] + v[1] * v[1]) - slope * v[2]) / sqrt(1.0 + slope * slope);
    return v[2] + radius > 0.0 && (!isfinite(slope) || outside < radius);
}

/* ---- claims: as catalog/prediction.py has them */
typedef struct { uint32_t at[6]; double weight[6]; } axis; /* neighbours along an axis of the grid */

static double table(const lcpf_file *f, uint32_t first, uint32_t k) { return f32(f->bytes + f->tables + 4u * (first + k)); }

/* The two values of a rising table around x; up to half a step beyond an end that end alone. 0 for a value farther out. */
static int around(const lcpf_file *f, uint32_t first, uint32_t count, double x, axis *out) {
    double low = table(f, first, 0), high = table(f, first, count - 1);
    double step = count > 1 ? table(f, first, 1) - low : 10.0, last = count > 1 ? high - table(f, first, count - 2) : 10.0;
    uint32_t k = 0;
    if (!(x >= low - 0.5 * step && x <= high + 0.5 * last)) return 0;
    while (k + 1 < count && table(f, first, k + 1) <= x) k++;
    int two = k + 1 < count && x > low;
    out->at[0] = k, out->at[1] = two ? k + 1 : k;
    out->weight[1] = two ? (x - table(f, first, k)) / (table(f, first, k + 1) - table(f, first, k)) : 0.0;
    out->weight[0] = 1.0 - out->weight[1];
    return 1;
}

/* Likewise for azimuths, of which the first follows the last. */
static int around_azimuth(const lcpf_file *f, double x, axis *out) {
    uint32_t first = f->elevations, count = f->azimuths;
    double low = table(f, first, 0), high = table(f, first, count - 1), widest = 0.0, gap = low + 360.0 - high;
    for (uint32_t k = 1; k < count; k++) widest = fmax(widest, table(f, first, k) - table(f, first, k - 1));
    if (x < low) x += 360.0;
    if (count > 1 && gap <= widest + 1e-3 && x > high) {
        out->at[0] = count - 1, out->at[1] = 0, out->weight[1] = (x - high) / gap, out->weight[0] = 1.0 - out->weight[1];
        return 1;
    }
    return around(f, first, count, x, out) || around(f, first, count, x - 360.0, out);
}

/* The two scales around pixel over cell, linear in its logarithm; a finer pixel counts as the finest. 0 for a coarser one. */
static int around_scale(const lcpf_file *f, double x, axis *out) {
    uint32_t first = f->elevations + f->azimuths + 3 * f->views, k = 0;
    x = fmax(fmax(x, 1.0), table(f, first, 0));
    if (!(x <= table(f, first, f->scales - 1) * (1.0 + 1e-7))) return 0;
    while (k + 2 < f->scales && table(f, first, k + 1) <= x) k++;
    out->at[0] = k, out->at[1] = f->scales > 1 ? k + 1 : k;
    out->weight[1] = f->scales > 1 ? log(x / table(f, first, k)) / log(table(f, first, k + 1) / table(f, first, k)) : 0.0;
    out->weight[0] = 1.0 - out->weight[1];
    return 1;
}

/* Unit direction of an azimuth and an angle from the vertical, degrees. */
static void direction(double azimuth, double off, double out[3]) {
    double a = azimuth * PI / 180.0, b = off * PI / 180.0;
    out[0] = sin(b) * sin(a), out[1] = sin(b) * cos(a), out[2] = cos(b);
}

/* Weights of a triangle's corners (3, 2) at its place nearest to p; the distance. */
static double nearest(double corner[3][2], const double p[2], double weight[3]) {
    double e[2], g[2], best = HUGE_VAL;
    for (int k = 0; k < 2; k++) e[k] = corner[1][k] - corner[0][k], g[k] = corner[2][k] - corner[0][k];
    double area = e[0] * g[1] - e[1] * g[0], x = p[0] - corner[0][0], y = p[1] - corner[0][1];
    double u = (x * g[1] - y * g[0]) / area, v = (e[0] * y - e[1] * x) / area;
    if (fabs(area) > 1e-9 && u >= -1e-9 && v >= -1e-9 && u + v <= 1.0 + 1e-9) {
        weight[0] = fmax(1.0 - u - v, 0.0), weight[1] = fmax(u, 0.0), weight[2] = fmax(v, 0.0);
        return 0.0;
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3;
        double s[2] = {corner[j][0] - corner[i][0], corner[j][1] - corner[i][1]}, length = s[0] * s[0] + s[1] * s[1];
        double t = (p[0] - corner[i][0]) * s[0] + (p[1] - corner[i][1]) * s[1];
        t = length > 0.0 ? fmin(fmax(t / length, 0.0), 1.0) : 0.0;
        double away = hypot(corner[i][0] + t * s[0] - p[0], corner[i][1] + t * s[1] - p[1]);
        if (!(away < best)) continue;
        best = away, weight[i] = 1.0 - t, weight[j] = t, weight[3 - i - j] = 0.0;
    }
    return best;
}

/* The triangle of views of a level of altitude that is nearest to a place, or of the level nearest to that if none is within
 * 20 deg of it; on the way there up to half of the weight is lost. 0 if there is none at all. */
static int of_level(const lcpf_file *f, const double p[2], int32_t level, double share, uint32_t *at, double *out) {
    uint32_t first = f->elevations + f->azimuths;
    int32_t number = -1, chosen = -1, off = INT32_MAX;
    double best = HUGE_VAL, last = NAN;
    for (uint32_t n = 0; n < f->triangles; n++) {
        const uint8_t *t = f->bytes + f->views_at + 3u * n;
        double corner[3][2], weight[3], altitude = table(f, first + 2 * f->views, t[0]);
        number += !(altitude == last), last = altitude;
        for (int k = 0; k < 3; k++) {
            double angle = table(f, first, t[k]), a = table(f, first + f->views, t[k]) * PI / 180.0;
            corner[k][0] = angle * sin(a), corner[k][1] = angle * cos(a);
        }
        double away = nearest(corner, p, weight);
        int32_t other = number > level ? number - level : level - number;
        if (!(away <= 20.0) || !(other < off || (number == chosen && away < best - 1e-9))) continue;
        best = away, off = other, chosen = number;
        for (int k = 0; k < 3; k++) at[k] = t[k], out[k] = share * weight[k] * (1.0 - 0.5 * away / 20.0);
    }
    return best <= 20.0;
}

/* The views around a direction in the azimuthal equidistant plane, linear in 1 / altitude between two levels. */
static int around_view(const lcpf_file *f, const double view[3], double altitude, axis *out) {
    double off = atan2(hypot(view[0], view[1]), view[2]) * 180.0 / PI, turn = atan2(view[0], view[1]), share = 0.0, low = 0.0;
    double p[2] = {off * sin(turn), off * cos(turn)}, last = NAN;
    int32_t number = -1, level[2] = {0, 0};
    for (uint32_t n = 0; n < f->triangles; n++) { /* levels stand in the file from the highest to the lowest */
        double one = 1.0 / table(f, f->elevations + f->azimuths + 2 * f->views, f->bytes[f->views_at + 3u * n]);
        if (one == last) continue;
        last = one, number++;
        if (number == 0 || one <= 1.0 / altitude) level[0] = level[1] = number, low = one;
        else if (level[1] == level[0]) level[1] = number, share = fmax((1.0 / altitude - low) / (one - low), 0.0);
    }
    if (level[1] == level[0]) share = 0.0;
    if (!(off < 90.0) || !of_level(f, p, level[0], 1.0 - share, out->at, out->weight)) return 0;
    of_level(f, p, level[1], share, out->at + 3, out->weight + 3);
    int same = out->at[0] == out->at[3] && out->at[1] == out->at[4] && out->at[2] == out->at[5];
    for (int k = 0; same && k < 3; k++) out->weight[k] += out->weight[3 + k], out->weight[3 + k] = 0.0; /* one level has both shares */
    return 1;
}

/* Logarithm of how clearly relief shows under a Sun and a view (landmarks/relief_signal.py). */
static double signal(const lcpf_file *f, const double sun[3], const double view[3]) {
    double mu0 = fmax(sun[2], 0.02), mu = fmax(view[2], 0.02), g[2];
    for (int k = 0; k < 2; k++) g[k] = (sun[k] + view[k]) / (mu0 + mu) - sun[k] / mu0;
    double slopes = fmax(hypot(g[0], g[1]), 0.03);
    return f->albedo_sigma > 0.0 ? log(slopes / hypot(f->albedo_sigma, f->slope_sigma * slopes)) : 0.0;
}

/* Height of a peak, in sigmas, that a probability stands for; the inverse. */
static double peak_height(double probability) {
    double low = -9.0, high = 9.0;
    for (int k = 0; k < 40; k++) {
        double x = 0.5 * (low + high);
        if (0.5 * erfc(-x * sqrt(0.5)) < probability) low = x; else high = x;
    }
    return 0.3 * log(1.0 + exp((2.2 + 1.1 * low) / 0.3));
}

static double probability_at(double height) {
    double bent = height / 0.3;
    return 0.5 * erfc(-(0.3 * (bent + log(-expm1(-bent))) - 2.2) / 1.1 * sqrt(0.5));
}

static void claim_of(const lcpf_file *f, const uint8_t *p, const double sun[3], const double view[3], double scale, double altitude, lcpf_claim *claim) {
    axis s, v, e, a;
    double up = atan2(sun[2], hypot(sun[0], sun[1])) * 180.0 / PI, turn = atan2(sun[0], sun[1]) * 180.0 / PI;
    double whole = 0.0, known = 0.0, square = 0.0, clear = 0.0, height = 0.0, size = 0.0, cosine = 0.0, sine = 0.0;
    claim->usable = 0, claim->probability = claim->sigma_major = claim->sigma_minor = claim->angle = NAN;
    if (!(sun[2] > 0.0) || !around_scale(f, scale, &s) || !around_view(f, view, altitude, &v)) return;
    if (!around(f, 0, f->elevations, up, &e) || !around_azimuth(f, turn < 0.0 ? turn + 360.0 : turn, &a)) return;
    for (int k = 0; k < 48; k++) {
        int is = k / 24, iv = k / 4 % 6, ie = k / 2 % 2, ia = k % 2;
        double w = s.weight[is] * v.weight[iv] * e.weight[ie] * a.weight[ia], one[3], other[3];
        uint32_t n = u16(f->bytes + f->numbers + 2u * (e.at[ie] * f->azimuths + a.at[ia])), at_view = f->elevations + f->azimuths;
        whole += w;
        if (!(w > 1e-9) || n >= f->suns) continue; /* a Sun that never occurs, or was left out */
        const uint8_t *c = p + claims_at(f) + 4u * ((s.at[is] * f->suns + n) * f->views + v.at[iv]);
        if (c[0] == NONE || c[1] == NONE || c[2] == NONE) continue;
        direction(table(f, f->elevations, a.at[ia]), 90.0 - table(f, 0, e.at[ie]), one);
        direction(table(f, at_view + f->views, v.at[iv]), table(f, at_view, v.at[iv]), other);
        double gain = signal(f, sun, view) - signal(f, one, other), q = f->probability_step, angle = c[3] % DEPENDENT * PI / 64.0;
        double la = f->sigma_log_least + f->sigma_log_step * c[1] - gain, lb = f->sigma_log_least + f->sigma_log_step * c[2] - gain;
        height += w * exp(gain) * peak_height(fmin(fmax(q * c[0], 0.5 * q), 1.0 - 0.5 * q));
        known += w, square += w * w, clear += c[3] < DEPENDENT ? w : 0.0;
        size += 0.5 * w * (la + lb), cosine += 0.5 * w * (la - lb) * cos(angle), sine += 0.5 * w * (la - lb) * sin(angle);
    }
    if (!(known >= 0.5 * whole && known > 0.0)) return;
    double found = fmin(fmax(probability_at(height / known), 0.5 * f->probability_step), 1.0 - 0.5 * f->probability_step);
    double gap = hypot(cosine, sine) / known, logit = log(found / (1.0 - found)) - 0.5 * (1.0 - square) - 1.5 * (1.0 - known);
    claim->probability = found, claim->sigma_major = exp(size / known + gap), claim->sigma_minor = exp(size / known - gap);
    claim->angle = fmod(atan2(sine, cosine) * 90.0 / PI + 180.0, 180.0);
    if (up < table(f, 0, 0) - 1e-5 || up > table(f, 0, f->elevations - 1) + 1e-5 || clear < 0.7 * known - 1e-9) return;
    claim->usable = 1.0 / (1.0 + exp(-logit)) >= f->min_detection - 0.5 * f->probability_step;
}

static int good_camera(const lcpf_camera *c) {
    double n[20]; /* position to distortion */
    memcpy(n, c, sizeof n);
    for (int k = 0; k < 20; k++) if (!isfinite(n[k])) return 0;
    return c->focal > 0.0 && c->width > 0 && c->height > 0 && finite3(c->sun);
}

/* A point in view: its pixel and its claim; 0 if it is not in the image, or on the far side. */
static int in_view(const lcpf_file *f, const lcpf_camera *c, uint32_t number, lcpf_claim *claim) {
    const uint8_t *p = point_at(f, number);
    double position[3], rotation[9], away[3], to_sun[3], sun[3], view[3];
    load_place(p, position, rotation);
    if (!lcpf_project(c, position, claim->pixel)) return 0;
    if (claim->pixel[0] < -0.5 || claim->pixel[0] > c->width - 0.5) return 0;
    if (claim->pixel[1] < -0.5 || claim->pixel[1] > c->height - 0.5) return 0;
    double range = towards(position, c->position, away);
    if (!(dot3(away, position) > 0.0)) return 0;
    towards(position, c->sun, to_sun);
    turned(rotation, to_sun, sun), turned(rotation, away, view);
    double depth = -dot3(c->rotation + 6, away); /* cosine of the angle to the axis: a pixel shrinks with its 3/2 power */
    claim->point = number, claim->pixel_size = range * depth * sqrt(depth) / c->focal;
    double altitude = 1e-3 * (sqrt(dot3(c->position, c->position)) - sqrt(dot3(position, position)));
    claim_of(f, p, sun, view, claim->pixel_size / f32(p + 68), altitude, claim);
    return 1;
}

int lcpf_in_view(const lcpf_file *f, const lcpf_camera *c, lcpf_claim *claims, uint32_t most, uint32_t *count) {
    *count = 0;
    if (!good_camera(c) || most == 0) return LCPF_ARGUMENT;
    double slope = cone(c);
    for (uint32_t t = 0; t < f->tiles; t++) {
        if (!may_be_seen(c, slope, tile_at(f, t))) continue;
        if (lcpf_check_tile(f, t)) return LCPF_DAMAGED;
        uint32_t first = u32(tile_at(f, t) + 28), end = first + u32(tile_at(f, t) + 32);
        for (uint32_t k = first; k < end; k++) {
            lcpf_claim one;
            if (!in_view(f, c, k, &one)) continue;
            if (*count < most) {
                claims[(*count)++] = one;
                continue;
            }
            uint32_t least = 0;
            for (uint32_t i = 1; i < most; i++) if (!(claims[i].probability >= claims[least].probability)) least = i;
            if (!(claims[least].probability >= one.probability) && !isnan(one.probability)) claims[least] = one;
        }
    }
    return LCPF_OK;
}

/* ---- light on a patch */
/* Factors of mu0 / (mu0 + mu) and of mu0 at a cosine of the phase. Lunar-Lambert: McEwen 1996, Yokota et al. 2011. */
static void phase_terms(const lcpf_law *law, double cosine, double out[2]) {
    const double *n = law->number;
    out[0] = 0.25 * n[0], out[1] = 0.0;
    if (!law->lunar_lambert) return;
    double g = acos(cosine) * 180.0 / PI, share = fmax(0.0, 1.0 + g * (-0.019 + g * (0.242e-3 - 1.46e-6 * g)));
    double above = sqrt(fmax(1.0 - cosine, 0.0)), below = sqrt(fmax(1.0 + cosine, 0.0)), b = n[4];
    double backward = 0.5 * (1.0 - n[3]) / pow(1.0 + b * b - 2.0 * b * cosine, 1.5);
    double forward = 0.5 * (1.0 + n[3]) / pow(1.0 + b * b + 2.0 * b * cosine, 1.5);
    double opposition = n[1] * n[2] * below / (n[2] * below + above);
    double f = n[0] * (1.0 + opposition) * (1.0 - b * b) * (backward + forward);
    out[0] = 2.0 * share * f, out[1] = (1.0 - share) * f;
}

/* Radiance factors of the nodes without cast shadows; corner (4, 3): directions to the camera from the corners nw, ne, sw, se. */
static void shade(const lcpf_point *point, const double sun[3], double corner[4][3], const lcpf_law *law, float *light) {
    int32_t p = point->nodes;
    double terms[4][2];
    for (int c = 0; c < 4; c++) phase_terms(law, fmin(1.0, fmax(-1.0, dot3(sun, corner[c]))), terms[c]);
    for (int32_t i = 0; i < p; i++) {
        int32_t up = i > 0 ? i - 1 : i, down = i < p - 1 ? i + 1 : i;
        for (int32_t j = 0; j < p; j++) {
            int32_t left = j > 0 ? j - 1 : j, right = j < p - 1 ? j + 1 : j;
            const float *z = point->height;
            double normal[3], view[3] = {0.0, 0.0, 0.0}, t0 = 0.0, t1 = 0.0;
            normal[0] = -((double)z[i * p + right] - z[i * p + left]) / ((right - left) * point->gsd);
            normal[1] = -((double)z[up * p + j] - z[down * p + j]) / ((down - up) * point->gsd);
            normal[2] = 1.0;
            double length = sqrt(dot3(normal, normal)), mu0 = dot3(normal, sun) / length;
            light[i * p + j] = 0.0f;
            if (!(mu0 > 0.0)) continue;
            double f = (double)j / (p - 1), g = (double)i / (p - 1), w[4] = {(1.0 - f) * (1.0 - g), f * (1.0 - g), (1.0 - f) * g, f * g};
            for (int c = 0; c < 4; c++) {
                for (int k = 0; k < 3; k++) view[k] += w[c] * corner[c][k];
                t0 += w[c] * terms[c][0], t1 += w[c] * terms[c][1];
            }
            double mu = fmax(dot3(normal, view) / (length * sqrt(dot3(view, view))), 0.0);
            light[i * p + j] = (float)((t0 * (mu0 / (mu0 + mu)) + t1 * mu0)) * point->albedo[i * p + j];
        }
    }
}

/* Least clearance, metres, of the ray from node (i, j) above the surface, at its crossings with columns (kind 0), rows (1) or
 * diagonals (2) up to `reach` steps; d: columns, rows and metres a step. */
static double crossings(const lcpf_point *point, int kind, int32_t i, int32_t j, const double d[3], double reach, double least) {
    int32_t p = point->nodes;
    const float *z = point->height;
    double rate = kind == 0 ? d[0] : kind == 1 ? d[1] : d[0] - d[1], start = z[i * p + j];
    for (int32_t k = 1; k < 2 * p && k / fabs(rate) <= reach; k++) {
        double s = k / fabs(rate), u = j + d[0] * s, v = i + d[1] * s, share;
        int32_t r, c, r2, c2, move = rate > 0.0 ? k : -k;
        if (kind == 0) {
            c = c2 = j + move, r = (int32_t)fmin(fmax(floor(v), 0.0), p - 2), r2 = r + 1, share = v - r;
        } else if (kind == 1) {
            r = r2 = i + move, c = (int32_t)fmin(fmax(floor(u), 0.0), p - 2), c2 = c + 1, share = u - c;
        } else {
            c = (int32_t)fmin(fmax(floor(u), 0.0), p - 2), r = c + i - j - move, c2 = c + 1, r2 = r + 1, share = u - c;
        }
        if (r < 0 || c < 0 || r2 >= p || c2 >= p) continue;
        double one = z[r * p + c], gap = start + d[2] * s - (one + (z[r2 * p + c2] - one) * share);
        if (gap < least && (s >= 2.5 || gap < 0.0)) least = gap; /* near its node a ray's clearance is no distance */
    }
    return least;
}

static double to_border(double place, double rate, double last) {
    return rate == 0.0 ? 1e9 : (1.0 + 1e-12) * (rate > 0.0 ? (last - place) / rate : -place / rate);
}

/* Clearance of each node's ray to the Sun above the patch itself; 1 everywhere where no facet is as steep as the rays. */
static void clearances(const lcpf_point *point, const double sun[3], float *clear) {
    int32_t p = point->nodes;
    const float *z = point->height;
    double summit = -1e30, steepest = 0.0, flat = hypot(sun[0], sun[1]), largest = fmax(fabs(sun[0]), fabs(sun[1]));
    for (int32_t k = 0; k < p * p; k++) {
        summit = fmax(summit, z[k]);
        if (k / p == p - 1 || k % p == p - 1) continue;
        double a = z[k], d = z[k + p + 1], b = z[k + 1], c = z[k + p];
        steepest = fmax(steepest, fmax((b - a) * (b - a) + (d - b) * (d - b), (c - a) * (c - a) + (d - c) * (d - c)));
    }
    int level = sun[2] * point->gsd >= sqrt(steepest) * flat || flat == 0.0;
    double d[3] = {sun[0] / largest, -sun[1] / largest, sun[2] * point->gsd / largest};
    for (int k = 0; k < 2; k++) if (!(fabs(d[k]) > 1e-12)) d[k] = 0.0;
    for (int32_t i = 0; i < p; i++)
        for (int32_t j = 0; j < p; j++) {
            double least = sun[2] > 0.0 ? 1.0 : -1.0;
            if (!level) {
                double reach = fmin(to_border(j, d[0], p - 1), to_border(i, d[1], p - 1));
                if (d[2] > 0.0) reach = fmin(reach, (summit - z[i * p + j]) / d[2] + 2.5);
                least = 1e9;
                if (d[0] != 0.0) least = crossings(point, 0, i, j, d, reach, least);
                if (d[1] != 0.0) least = crossings(point, 1, i, j, d, reach, least);
                if (d[0] != d[1]) least = crossings(point, 2, i, j, d, reach, least);
            }
            clear[i * p + j] = (float)least;
        }
}

/* ---- drawing */
/* Draw a triangle of nodes n where it is the nearest so far: `known` holds depths meanwhile. Seen from below it is NaN. */
static void triangle(lcpf_work *work, const int32_t n[3]) {
    lcpf_template *t = &work->shown;
    const double *x = work->u.draw.x, *y = work->u.draw.y, *d = work->u.draw.far;
    const float *b = work->u.draw.light, *m = work->u.draw.clear;
    double x0 = x[n[0]], y0 = y[n[0]], ax = x[n[1]] - x0, ay = y[n[1]] - y0, bx = x[n[2]] - x0, by = y[n[2]] - y0;
    double area = ax * by - ay * bx;
    if (!(fabs(area) > 1e-12)) return;
    int32_t wide = t->cols * t->sub, high = t->rows * t->sub;
    int32_t col0 = (int32_t)fmax(ceil(x0 + fmin(0.0, fmin(ax, bx))), 0.0), row0 = (int32_t)fmax(ceil(y0 + fmin(0.0, fmin(ay, by))), 0.0);
    int32_t col1 = (int32_t)fmin(floor(x0 + fmax(0.0, fmax(ax, bx))), wide - 1);
    int32_t row1 = (int32_t)fmin(floor(y0 + fmax(0.0, fmax(ay, by))), high - 1);
    double inverse = 1.0 / area;
    for (int32_t row = row0; row <= row1; row++)
        for (int32_t col = col0; col <= col1; col++) {
            double px = col - x0, py = row - y0, s = (px * by - py * bx) * inverse, r = (ax * py - ay * px) * inverse;
            if (s < -1e-9 || r < -1e-9 || s + r > 1.0 + 1e-9) continue;
            int32_t at = row * wide + col % t->sub * t->cols + col / t->sub;
            float far = (float)(d[n[0]] + s * (d[n[1]] - d[n[0]]) + r * (d[n[2]] - d[n[0]]));
            if (!(far < t->known[at])) continue;
            t->known[at] = far;
            double clear = m[n[0]] + s * ((double)m[n[1]] - m[n[0]]) + r * ((double)m[n[2]] - m[n[0]]);
            double light = b[n[0]] + s * ((double)b[n[1]] - b[n[0]]) + r * ((double)b[n[2]] - b[n[0]]);
            t->drawing[at] = area < 0.0 ? NAN : clear >= 0.0 ? (float)light : 0.0f;
        }
}

/* Twice the integral of a Gaussian step up to x, and the step. */
static double ramp(double x, double sigma, double *step) {
    if (sigma <= 0.0) {
        *step = x > 0.0 ? 1.0 : x == 0.0 ? 0.5 : 0.0;
        return fmax(x, 0.0);
    }
    double t = x / sigma;
    *step = 0.5 * erfc(-t * sqrt(0.5));
    return x * *step + sigma / sqrt(2.0 * PI) * exp(-0.5 * t * t);
}

/* Weights of the samples around a pixel through its square and a Gaussian, and their derivatives with respect to the shift of
 * the drawing, pixels; a sample stands for a square. Returns the number of the first, from the pixel's own first. */
static int32_t taps(int32_t sub, double sigma, double shift, float *weight, float *slope, int32_t *count) {
    double narrow = sqrt(fmax(sigma * sigma - 1.0 / (12.0 * sub * sub), 0.0)), half = 0.5 + 4.0 * narrow + 1.0 / sub;
    int32_t first = (int32_t)floor((0.5 - half - shift) * sub), last = (int32_t)ceil((0.5 + half - shift) * sub);
    *count = last - first < LCPF_TAPS ? last - first : LCPF_TAPS;
    for (int32_t k = 0; k < *count; k++) {
        double a = (double)(first + k) / sub - 0.5 + shift, b = a + 1.0 / sub, s[4];
        double r = ramp(b + 0.5, narrow, s) - ramp(a + 0.5, narrow, s + 1) - ramp(b - 0.5, narrow, s + 2) + ramp(a - 0.5, narrow, s + 3);
        weight[k] = (float)r, slope[k] = (float)(s[0] - s[1] - s[2] + s[3]);
    }
    return first;
}

static void down(const float *rows, int32_t n, int32_t high, int32_t first, const float *w, int32_t count, float *restrict out) {
    int32_t k = first < 0 ? -first : 0, end = count < high - first ? count : high - first;
    for (int32_t c = 0; c < n; c++) out[c] = 0.0f;
    for (; k + 3 < end; k += 4) { /* four at a time */
        const float *a = rows + (size_t)(first + k) * n, *b = a + n, *d = b + n, *e = d + n;
        for (int32_t c = 0; c < n; c++) out[c] += (w[k] * a[c] + w[k + 1] * b[c]) + (w[k + 2] * d[c] + w[k + 3] * e[c]);
    }
    for (; k < end; k++) {
        const float *a = rows + (size_t)(first + k) * n;
        for (int32_t c = 0; c < n; c++) out[c] += w[k] * a[c];
    }
}

static void across(const float *line, int32_t cols, int32_t sub, int32_t first, const float *w, int32_t count, float *restrict out) {
    for (int32_t c = 0; c < cols; c++) out[c] = 0.0f;
    for (int32_t k = 0; k < count; k++) {
        int32_t s = ((first + k) % sub + sub) % sub, by = (first + k - s) / sub;
        int32_t c0 = by < 0 ? -by : 0, c1 = by > 0 ? cols - by : cols, x = s * cols + by;
        for (int32_t c = c0; c < c1; c++) out[c] += w[k] * line[x + c];
    }
}

/* Pixels of the drawing moved by a shift: value, derivatives right and down (if sloped), share of the point spread on it. */
static void blurred(lcpf_work *work, double right, double below, int sloped) {
    lcpf_template *t = &work->shown;
    float wx[LCPF_TAPS], gx[LCPF_TAPS], wy[LCPF_TAPS], gy[LCPF_TAPS], sum[6][LCPF_SIDE], *line = work->u.fit.line;
    int32_t nx, ny, cols = t->cols, n = cols * t->sub, high = t->rows * t->sub;
    int32_t fx = taps(t->sub, t->sigma, right, wx, gx, &nx), fy = taps(t->sub, t->sigma, below, wy, gy, &ny);
    for (int32_t r = 0; r < t->rows; r++) {
        for (int k = 0; k < 2; k++) {
            const float *rows = k ? t->known : t->drawing;
            down(rows, n, high, r * t->sub + fy, wy, ny, line);
            across(line, cols, t->sub, fx, wx, nx, sum[3 * k]);
            if (!sloped) continue;
            across(line, cols, t->sub, fx, gx, nx, sum[3 * k + 1]);
            down(rows, n, high, r * t->sub + fy, gy, ny, line);
            across(line, cols, t->sub, fx, wx, nx, sum[3 * k + 2]);
        }
        for (int32_t c = 0; c < cols; c++) {
            float inverse = sum[3][c] > 1e-6f ? 1.0f / sum[3][c] : 0.0f, value = sum[0][c] * inverse;
            work->u.fit.seen[0][r * cols + c] = value, work->u.fit.seen[3][r * cols + c] = sum[3][c];
            for (int k = 1; sloped && k < 3; k++)
                work->u.fit.seen[k][r * cols + c] = (sum[k][c] - value * sum[3 + k][c]) * inverse;
        }
    }
}

/* Pixels of the nodes and directions to the camera from the corners; the template's place and size. */
static int place(const lcpf_point *point, const lcpf_camera *camera, double corner[4][3], lcpf_work *work) {
    lcpf_template *t = &work->shown;
    int32_t p = point->nodes;
    double low[2] = {1e9, 1e9}, high[2] = {-1e9, -1e9}, half = 0.5 * (p - 1), position[3], away[3];
    if (!lcpf_project(camera, point->position, t->predicted)) return LCPF_NOT_SEEN;
    for (int32_t k = 0; k < p * p; k++) {
        double east = (k % p - half) * point->gsd, north = (half - k / p) * point->gsd, pixel[2];
        for (int i = 0; i < 3; i++)
            position[i] = point->position[i] + east * point->rotation[i] + north * point->rotation[3 + i] +
                          point->height[k] * point->rotation[6 + i];
        if (!lcpf_project(camera, position, pixel)) return LCPF_NOT_SEEN;
        work->u.draw.x[k] = pixel[0], work->u.draw.y[k] = pixel[1];
        for (int i = 0; i < 2; i++) low[i] = fmin(low[i], pixel[i]), high[i] = fmax(high[i], pixel[i]);
        if ((k / p == 0 || k / p == p - 1) && (k % p == 0 || k % p == p - 1)) {
            towards(position, camera->position, away);
            turned(point->rotation, away, corner[(k / p > 0 ? 2 : 0) + (k % p > 0 ? 1 : 0)]);
        }
    }
    int32_t size[2];
    for (int i = 0; i < 2; i++) {
        t->origin[i] = (int32_t)floor(low[i] + 0.5);
        size[i] = (int32_t)ceil(high[i] - 0.5) - t->origin[i] + 1;
        if (size[i] < 1) size[i] = 1;
    }
    t->cols = size[0], t->rows = size[1];
    const double *x = work->u.draw.x, *y = work->u.draw.y;
    int32_t ne = p - 1, sw = p * (p - 1);
    double area = fabs((x[ne] - x[0]) * (y[sw] - y[0]) - (y[ne] - y[0]) * (x[sw] - x[0])) / ((double)(p - 1) * (p - 1));
    t->sub = (int32_t)fmin(fmax(ceil(2.0 / sqrt(fmax(area, 1e-6))), 3.0), 8.0);
    if (t->rows > LCPF_SIDE || t->cols > LCPF_SIDE) return LCPF_TOO_LARGE;
    return t->rows * t->sub > LCPF_SAMPLES || t->cols * t->sub > LCPF_SAMPLES ? LCPF_TOO_LARGE : LCPF_OK;
}

int lcpf_render(const lcpf_point *point, const lcpf_camera *camera, const lcpf_law *law, double sigma, lcpf_work *work) {
    lcpf_template *t = &work->shown;
    double corner[4][3] = {{0}}, away[3], sun[3], look[3];
    int32_t p = point->nodes;
    t->count = t->rows = t->cols = 0;
    if (!good_camera(camera) || !(sigma >= 0.0 && sigma <= 1.0) || p < 3 || p > LCPF_NODES) return LCPF_ARGUMENT;
    int code = place(point, camera, corner, work);
    if (code) return t->rows = t->cols = 0, code;
    t->sigma = sigma;
    towards(point->position, camera->sun, away);
    turned(point->rotation, away, sun);
    if (!finite3(sun)) return LCPF_ARGUMENT;
    shade(point, sun, corner, law, work->u.draw.light);
    clearances(point, sun, work->u.draw.clear);
    for (int k = 0; k < 3; k++) look[k] = corner[0][k] + corner[1][k] + corner[2][k] + corner[3][k];
    for (int32_t k = 0; k < p * p; k++) {
        double east = (k % p - 0.5 * (p - 1)) * point->gsd, north = (0.5 * (p - 1) - k / p) * point->gsd;
        work->u.draw.x[k] = (work->u.draw.x[k] - t->origin[0] + 0.5) * t->sub - 0.5;
        work->u.draw.y[k] = (work->u.draw.y[k] - t->origin[1] + 0.5) * t->sub - 0.5;
        work->u.draw.far[k] = -(east * look[0] + north * look[1] + point->height[k] * look[2]);
    }
    int32_t samples = t->rows * t->cols * t->sub * t->sub;
    for (int32_t k = 0; k < samples; k++) t->drawing[k] = NAN, t->known[k] = HUGE_VALF;
    for (int32_t i = 0; i < p - 1; i++)
        for (int32_t j = 0; j < p - 1; j++) {
            int32_t n = i * p + j, upper[3] = {n, n + 1, n + p + 1}, lower[3] = {n, n + p + 1, n + p};
            triangle(work, upper), triangle(work, lower);
        }
    for (int32_t k = 0; k < samples; k++) {
        t->known[k] = isnan(t->drawing[k]) ? 0.0f : 1.0f;
        if (isnan(t->drawing[k])) t->drawing[k] = 0.0f;
    }
    blurred(work, 0.0, 0.0, 0);
    double total = 0.0, square = 0.0;
    int32_t lit = 0;
    for (int32_t k = 0; k < t->rows * t->cols; k++) {
        t->mask[k] = work->u.fit.seen[3][k] >= COVER;
        float value = t->value[k] = t->mask[k] ? work->u.fit.seen[0][k] : 0.0f;
        t->count += t->mask[k], lit += value > 0.0f, total += value, square += (double)value * value;
    }
    if (t->count == 0) return LCPF_NOT_SEEN;
    double mean = total / t->count;
    if (lit < 0.3 * t->count) return LCPF_NOT_LIT;
    return t->count < 36 || !(sqrt(fmax(square / t->count - mean * mean, 0.0)) > 0.005 * mean) ? LCPF_PLAIN : LCPF_OK;
}

/* ---- search */
void lcpf_half(const float *fine, int32_t rows, int32_t cols, float *half) {
    for (int32_t r = 0; r < rows / 2; r++)
        for (int32_t c = 0; c < cols / 2; c++) {
            const float *x = fine + (size_t)(2 * r) * cols + 2 * c, *y = x + cols;
            half[(size_t)r * (cols / 2) + c] = 0.25f * ((x[0] + y[0]) + (x[1] + y[1]));
        }
}

typedef struct { /* a template of unit length and zero mean, 0 outside its mask, and the image that it is sought in */
    const float *value, *image, *weight;
    const uint8_t *mask;
    int32_t rows, cols, count, high, wide;
} sought;

typedef struct { int32_t row, col; double height; } peak;

/* Centre and scale the values under a mask in place; the number of its pixels, 0 if they are flat. */
static int32_t centred(float *value, const uint8_t *mask, int32_t pixels) {
    double total = 0.0, power = 0.0;
    int32_t count = 0;
    for (int32_t k = 0; k < pixels; k++) if (mask[k]) total += value[k], count++;
    double mean = total / (count ? count : 1);
    for (int32_t k = 0; k < pixels; k++) if (mask[k]) power += (value[k] - mean) * (value[k] - mean);
    if (!(power > 1e-14 * mean * mean * count)) return 0;
    for (int32_t k = 0; k < pixels; k++) value[k] = mask[k] ? (float)((value[k] - mean) / sqrt(power)) : 0.0f;
    return count;
}

/* Correlations at ny x nx places from (row, col) on, into the score; the highest share of valid pixels, and the image's variance. */
static double correlate(const sought *t, int32_t row, int32_t col, int32_t ny, int32_t nx, lcpf_work *work, double *variance) {
    float *score = work->u.search.score, *region = work->u.search.region, *real = work->u.search.real;
    double *one = work->u.search.one, *two = work->u.search.two, mean = 0.0, power = 0.0, best = 0.0;
    int32_t high = ny + t->rows - 1, wide = nx + t->cols - 1, band = LCPF_ROWS - t->rows + 1, step = wide + 1;
    for (int32_t r = 0; r < high; r++) for (int32_t c = 0; c < wide; c++) mean += t->image[(size_t)(row + r) * t->wide + col + c];
    mean /= (double)high * wide;
    for (int32_t r = 0; r < high; r++)
        for (int32_t c = 0; c < wide; c++) {
            float x = (float)(t->image[(size_t)(row + r) * t->wide + col + c] - mean);
            power += (double)x * x;
        }
    *variance = power / ((double)high * wide);
    double flat = 1e-6 * *variance * t->count;
    for (int32_t top = 0; top < ny; top += band) {
        int32_t some = ny - top < band ? ny - top : band;
        for (int32_t r = 0; r < some + t->rows - 1; r++) { /* sums along each row */
            size_t source = (size_t)(row + top + r) * t->wide + col;
            int32_t at = r * step;
            one[at] = two[at] = 0.0, real[at] = 0.0f;
            for (int32_t c = 0; c < wide; c++) {
                float x = region[r * wide + c] = (float)(t->image[source + c] - mean);
                one[at + c + 1] = one[at + c] + x, two[at + c + 1] = two[at + c] + (double)x * x;
                real[at + c + 1] = real[at + c] + (t->weight ? t->weight[source + c] : 1.0f);
            }
        }
        for (int32_t y = 0; y < some; y++) {
            float sum[2 * LCPF_REACH + 1] = {0};
            double first[2 * LCPF_REACH + 1] = {0}, second[2 * LCPF_REACH + 1] = {0}, known[2 * LCPF_REACH + 1] = {0};
            for (int32_t i = 0; i < t->rows; i++) {
                const float *x = region + (y + i) * wide, *v = t->value + i * t->cols;
                for (int32_t j = 0; j < t->cols; j++) for (int32_t k = 0; k < nx; k++) sum[k] += v[j] * x[j + k];
                const uint8_t *mask = t->mask + i * t->cols;
                for (int32_t j = 0, end = 0; j < t->cols; j = end + 1) {
                    for (end = j; end < t->cols && mask[end];) end++;
                    int32_t a = (y + i) * step + j, b = (y + i) * step + end;
                    for (int32_t k = 0; end > j && k < nx; k++)
                        first[k] += one[b + k] - one[a + k], second[k] += two[b + k] - two[a + k], known[k] += real[b + k] - real[a + k];
                }
            }
            for (int32_t k = 0; k < nx; k++) {
                double spread = second[k] - first[k] * first[k] / t->count;
                best = fmax(best, known[k] / t->count);
                score[(top + y) * nx + k] = known[k] < REAL * t->count ? NOWHERE : spread > flat ? (float)(sum[k] / sqrt(spread)) : 0.0f;
            }
        }
    }
    return best;
}

/* The highest places above 0 without a higher neighbour, best first; their number. */
static int maxima(const float *score, int32_t ny, int32_t nx, peak found[LCPF_PEAKS]) {
    int count = 0;
    for (int32_t y = 0; y < ny; y++)
        for (int32_t x = 0; x < nx; x++) {
            float here = score[y * nx + x];
            int highest = here > 0.0f;
            for (int32_t k = 0; highest && k < 9; k++) {
                int32_t r = y + k / 3 - 1, c = x + k % 3 - 1;
                if (r >= 0 && r < ny && c >= 0 && c < nx && score[r * nx + c] > here) highest = 0;
            }
            if (!highest || (count == LCPF_PEAKS && here <= found[count - 1].height)) continue;
            int k = count < LCPF_PEAKS ? count++ : LCPF_PEAKS - 1;
            for (; k > 0 && found[k - 1].height < here; k--) found[k] = found[k - 1];
            found[k].row = y, found[k].col = x, found[k].height = here;
        }
    return count;
}

/* Correlation with one window of the image. */
static double at(const sought *t, double flat, int32_t row, int32_t col) {
    if (row < 0 || col < 0 || row + t->rows > t->high || col + t->cols > t->wide) return NOWHERE;
    double origin = t->image[(size_t)row * t->wide + col], both = 0.0, first = 0.0, second = 0.0, real = 0.0;
    for (int32_t i = 0; i < t->rows; i++) {
        size_t source = (size_t)(row + i) * t->wide + col;
        for (int32_t j = 0; j < t->cols; j++) {
            if (!t->mask[i * t->cols + j]) continue;
            double x = t->image[source + j] - origin;
            both += t->value[i * t->cols + j] * x, first += x, second += x * x;
            real += t->weight ? t->weight[source + j] : 1.0;
        }
    }
    if (real < REAL * t->count) return NOWHERE;
    double variance = second - first * first / t->count;
    return variance > fmax(flat, 1e-12 * second) ? both / sqrt(variance) : 0.0;
}

/* Steepest ascent, a pixel a step, eight at most, within limits (first and last row, first and last column). */
static void climb(const sought *t, double flat, const int32_t limit[4], peak *p) {
    int32_t old_row = p->row - 9, old_col = p->col - 9;
    p->height = at(t, flat, p->row, p->col);
    for (int step = 0; step < 8; step++) {
        peak best = *p;
        for (int k = 0; k < 9; k++) {
            int32_t r = p->row + k / 3 - 1, c = p->col + k % 3 - 1;
            int before = r - old_row <= 1 && old_row - r <= 1 && c - old_col <= 1 && old_col - c <= 1;
            if (k == 4 || before || r < limit[0] || r > limit[1] || c < limit[2] || c > limit[3]) continue;
            double here = at(t, flat, r, c);
            if (here > best.height) best.row = r, best.col = c, best.height = here;
        }
        if (best.row == p->row && best.col == p->col) return;
        old_row = p->row, old_col = p->col, *p = best;
    }
}

/* First and last row and column of a window of an image within reach of a place; 1 if there are any. */
static int window(const sought *t, int32_t row, int32_t col, int32_t reach, int32_t out[4]) {
    out[0] = row - reach > 0 ? row - reach : 0, out[1] = t->high - t->rows < row + reach ? t->high - t->rows : row + reach;
    out[2] = col - reach > 0 ? col - reach : 0, out[3] = t->wide - t->cols < col + reach ? t->wide - t->cols : col + reach;
    return out[1] >= out[0] && out[3] >= out[2];
}

/* The template at half resolution on the 2 x 2 blocks of the image; row, col: its place. */
static void halved(const sought *t, int32_t row, int32_t col, const lcpf_image *image, lcpf_work *work, sought *out) {
    float *small = work->u.search.small;
    uint8_t *inside = work->u.search.inside;
    int32_t odd_row = (row % 2 + 2) % 2, odd_col = (col % 2 + 2) % 2;
    out->rows = (t->rows + odd_row + 1) / 2, out->cols = (t->cols + odd_col + 1) / 2;
    for (int32_t k = 0; k < out->rows * out->cols; k++) {
        float total = 0.0f;
        int32_t cover = 0;
        for (int32_t i = 0; i < 4; i++) {
            int32_t r = 2 * (k / out->cols) + i / 2 - odd_row, c = 2 * (k % out->cols) + i % 2 - odd_col;
            if (r < 0 || c < 0 || r >= t->rows || c >= t->cols || !t->mask[r * t->cols + c]) continue;
            total += t->value[r * t->cols + c], cover++;
        }
        inside[k] = cover >= 2, small[k] = cover >= 2 ? total / (float)cover : 0.0f;
    }
    out->value = small, out->mask = inside, out->image = image->half, out->weight = image->half_weight;
    out->high = image->rows / 2, out->wide = image->cols / 2;
    out->count = centred(small, inside, out->rows * out->cols);
}

/* Peaks of the correlation within limits, of which those at half resolution are followed up; the highest share of valid pixels. */
static int peaks(const sought *t, const sought *small, int32_t row, int32_t col, const int32_t limit[4], int32_t reach, lcpf_work *work,
                 peak found[LCPF_PEAKS], double *real) {
    double variance;
    int32_t box[4], top = (row - (row % 2 + 2) % 2) / 2, left = (col - (col % 2 + 2) % 2) / 2, nx = limit[3] - limit[2] + 1;
    if (!small) {
        *real = correlate(t, limit[0], limit[2], limit[1] - limit[0] + 1, nx, work, &variance);
        int count = maxima(work->u.search.score, limit[1] - limit[0] + 1, nx, found);
        for (int k = 0; k < count; k++) found[k].row += limit[0], found[k].col += limit[2];
        return count;
    }
    *real = 0.0;
    if (small->count == 0 || !window(small, top, left, (reach + 1) / 2, box)) return 0;
    nx = box[3] - box[2] + 1;
    *real = correlate(small, box[0], box[2], box[1] - box[0] + 1, nx, work, &variance);
    int count = maxima(work->u.search.score, box[1] - box[0] + 1, nx, found), kept = 0;
    for (int k = 0; k < count; k++) {
        if (kept > 0 && found[k].height < found[0].height - 0.15) break;
        peak one = {row + 2 * (found[k].row + box[0] - top), col + 2 * (found[k].col + box[2] - left), 0.0};
        one.row = one.row < limit[0] ? limit[0] : one.row > limit[1] ? limit[1] : one.row;
        one.col = one.col < limit[2] ? limit[2] : one.col > limit[3] ? limit[3] : one.col;
        climb(t, 1e-6 * variance * t->count, limit, &one);
        found[kept++] = one;
    }
    return kept;
}

int lcpf_search(const lcpf_image *image, const int32_t offset[2], int32_t reach, lcpf_work *work, lcpf_match *match) {
    const lcpf_template *s = &work->shown;
    int32_t r0 = s->rows, r1 = 0, c0 = s->cols, c1 = 0, limit[4];
    match->shift[0] = match->shift[1] = 0, match->correlation = match->second = NAN;
    if (reach < 1 || reach > LCPF_REACH || image->rows < 1 || image->cols < 1 || !image->fine || !image->half) return LCPF_ARGUMENT;
    if (offset[0] < -1000000 || offset[0] > 1000000 || offset[1] < -1000000 || offset[1] > 1000000) return LCPF_ARGUMENT;
    for (int32_t k = 0; k < s->rows * s->cols; k++) {
        if (!s->mask[k]) continue;
        int32_t r = k / s->cols, c = k % s->cols;
        r0 = r < r0 ? r : r0, r1 = r + 1 > r1 ? r + 1 : r1, c0 = c < c0 ? c : c0, c1 = c + 1 > c1 ? c + 1 : c1;
    }
    if (r0 >= r1) return LCPF_NOT_SEEN;
    sought t = {work->u.search.cut, image->fine, image->weight, work->u.search.mask, r1 - r0, c1 - c0, 0, image->rows, image->cols};
    sought small = t;
    for (int32_t k = 0; k < t.rows * t.cols; k++) {
        int32_t source = (r0 + k / t.cols) * s->cols + c0 + k % t.cols;
        work->u.search.cut[k] = s->value[source], work->u.search.mask[k] = s->mask[source];
    }
    int32_t row = s->origin[1] + offset[1] + r0, col = s->origin[0] + offset[0] + c0, coarse = s->count >= HALVED_FROM;
    if (coarse) halved(&t, row, col, image, work, &small);
    t.count = centred(work->u.search.cut, work->u.search.mask, t.rows * t.cols);
    if (t.count == 0) return LCPF_PLAIN;
    if (!window(&t, row, col, reach, limit)) return LCPF_AT_THE_EDGE;
    peak found[LCPF_PEAKS];
    double real, side = 2.0 * reach + 1.0, exclusion = 0.5 * sqrt(s->count);
    int count = peaks(&t, coarse ? &small : NULL, row, col, limit, reach, work, found, &real), best = 0;
    if ((limit[1] - limit[0] + 1.0) * (limit[3] - limit[2] + 1.0) < 0.3 * side * side || real < REAL) return LCPF_AT_THE_EDGE;
    if (count == 0) return LCPF_NO_PEAK;
    for (int k = 1; k < count; k++) if (found[k].height > found[best].height) best = k;
    for (int k = 0; k < count; k++) {
        double away = hypot(found[k].row - found[best].row, found[k].col - found[best].col);
        if (away > exclusion && found[k].height > -1.0 && !(match->second >= found[k].height)) match->second = found[k].height;
    }
    match->correlation = found[best].height;
    match->shift[0] = found[best].col - col + offset[0], match->shift[1] = found[best].row - row + offset[1];
    return LCPF_OK;
}

/* ---- fit */
/* Solution of [[a, b, c], [b, d, e], [c, e, f]] x = r; NaN when singular. */
static void solve3(const double m[6], const double r[3], double x[3]) {
    double a = m[0], b = m[1], c = m[2], d = m[3], e = m[4], f = m[5];
    double m00 = d * f - e * e, m01 = c * e - b * f, m02 = b * e - c * d, m11 = a * f - c * c, m12 = b * c - a * e, m22 = a * d - b * b;
    double det = a * m00 + b * m01 + c * m02, scale = fabs(a * d * f);
    double inverse = fabs(det) > 1e-12 * scale && scale > 0.0 ? 1.0 / det : NAN;
    x[0] = (m00 * r[0] + m01 * r[1] + m02 * r[2]) * inverse;
    x[1] = (m01 * r[0] + m11 * r[1] + m12 * r[2]) * inverse;
    x[2] = (m02 * r[0] + m12 * r[1] + m22 * r[2]) * inverse;
}

/* Weights of the template's pixels in the image, rising with the cover of the point spread at its edge; the image's light; both
 * and the template with its slopes less their means. The sum of the weights. */
static double gather(const lcpf_image *image, int32_t row0, int32_t col0, lcpf_work *work) {
    const lcpf_template *t = &work->shown;
    double *w = work->u.fit.w, *light = work->u.fit.light, total = 0.0, mean[4] = {0.0, 0.0, 0.0, 0.0};
    int32_t pixels = t->rows * t->cols;
    for (int32_t k = 0; k < pixels; k++) {
        int32_t i = row0 + k / t->cols, j = col0 + k % t->cols;
        int inside = i >= 0 && i < image->rows && j >= 0 && j < image->cols;
        size_t source = inside ? (size_t)i * image->cols + j : 0;
        double cover = fmin(fmax((work->u.fit.seen[3][k] - (2.0 * COVER - 1.0)) / (2.0 - 2.0 * COVER), 0.0), 1.0);
        w[k] = inside ? (image->weight ? image->weight[source] : 1.0) * cover : 0.0;
        light[k] = w[k] > 0.0 ? image->fine[source] : 0.0;
        total += w[k], mean[3] += w[k] * light[k];
        for (int n = 0; n < 3; n++) mean[n] += w[k] * work->u.fit.seen[n][k];
    }
    for (int32_t k = 0; k < pixels; k++) {
        light[k] -= mean[3] / total;
        for (int n = 0; n < 3; n++) work->u.fit.seen[n][k] = (float)(work->u.fit.seen[n][k] - mean[n] / total);
    }
    return total;
}

/* One Gauss-Newton step: right, down and gain; the correlation before it. NaN for a singular system or a gain below 0. */
static double gauss_newton(const lcpf_work *work, int32_t pixels, double x[3]) {
    const float *t = work->u.fit.seen[0], *gx = work->u.fit.seen[1], *gy = work->u.fit.seen[2];
    const double *w = work->u.fit.w, *light = work->u.fit.light;
    double m[6] = {0}, r[3] = {0}, power = 0.0;
    for (int32_t k = 0; k < pixels; k++) {
        double a = w[k] * gx[k], b = w[k] * gy[k], c = w[k] * t[k];
        m[0] += a * gx[k], m[1] += a * gy[k], m[2] += a * t[k], m[3] += b * gy[k], m[4] += b * t[k], m[5] += c * t[k];
        r[0] += a * light[k], r[1] += b * light[k], r[2] += c * light[k], power += w[k] * light[k] * light[k];
    }
    x[0] = x[1] = x[2] = NAN;
    if (!(m[5] > 0.0 && power > 0.0)) return NAN;
    solve3(m, r, x);
    if (!(x[2] > 0.0)) x[0] = x[1] = x[2] = NAN;
    x[0] /= x[2], x[1] /= x[2];
    return r[2] / sqrt(m[5] * power);
}

/* Covariance of the shift M^-1 B M^-1 with residuals that are correlated up to 7 pixels (Newey and West 1987, in two dimensions). */
static void covariance(lcpf_work *work, lcpf_match *match) {
    const lcpf_template *s = &work->shown;
    float *t = work->u.fit.seen[0], *gx = work->u.fit.seen[1], *gy = work->u.fit.seen[2];
    double *w = work->u.fit.w, *rest = work->u.fit.rest, tt = 0.0, tl = 0.0, tx = 0.0, ty = 0.0, *out = match->covariance;
    int32_t rows = s->rows, cols = s->cols, count = 0;
    for (int32_t k = 0; k < rows * cols; k++) {
        double c = w[k] * t[k];
        tt += c * t[k], tl += c * work->u.fit.light[k], tx += c * gx[k], ty += c * gy[k];
    }
    double gain = tl / tt;
    for (int32_t k = 0; k < rows * cols; k++) { /* slopes without their shares of gain and offset; residuals */
        gx[k] = (float)((gx[k] - tx / tt * t[k]) * gain * w[k]), gy[k] = (float)((gy[k] - ty / tt * t[k]) * gain * w[k]);
        rest[k] = (work->u.fit.light[k] - gain * t[k]) * w[k], count += w[k] > 0.0;
    }
    double bxx = 0.0, bxy = 0.0, byy = 0.0, mxx = 0.0, mxy = 0.0, myy = 0.0, white = 0.0, near = 0.0;
    for (int32_t down = 0; down < 8; down++)
        for (int32_t right = down ? -7 : 0; right < 8; right++) {
            int32_t c0 = right < 0 ? -right : 0, c1 = right > 0 ? cols - right : cols, lag = down * cols + right;
            int32_t side = c0 > 0 ? c0 : right;
            double pairs = 0.0, both = 0.0, xx = 0.0, xy = 0.0, yy = 0.0;
            for (int32_t r = 0; r < rows - down; r++)
                for (int32_t a = r * cols + c0, b = a + lag; a < r * cols + c1; a++, b++) {
                    pairs += w[a] * w[b], both += rest[a] * rest[b];
                    xx += gx[a] * gx[b], xy += gx[a] * gy[b] + gy[a] * gx[b], yy += gy[a] * gy[b];
                }
            if (!(pairs > 0.0)) continue;
            double taper = (1.0 - side / 8.0) * (1.0 - down / 8.0), here = both / pairs, factor = 2.0 * taper * here;
            if (lag == 0) {
                factor = white = here * count / fmax(count - 4.0, 1.0);
                mxx = xx, mxy = 0.5 * xy, myy = yy;
            } else if (down + side == 1) {
                near += 0.5 * here;
            }
            bxx += factor * xx, bxy += factor * 0.5 * xy, byy += factor * yy;
        }
    double det = mxx * myy - mxy * mxy;
    out[0] = out[1] = out[2] = NAN;
    if (!(det > 1e-9 * mxx * myy)) return;
    double ixx = myy / det, ixy = -mxy / det, iyy = mxx / det;
    double pxx = ixx * bxx + ixy * bxy, pxy = ixx * bxy + ixy * byy, pyx = ixy * bxx + iyy * bxy, pyy = ixy * bxy + iyy * byy;
    out[0] = pxx * ixx + pxy * ixy, out[1] = pxx * ixy + pxy * iyy, out[2] = pyx * ixy + pyy * iyy;
    if (!(out[0] > white * ixx && out[2] > white * iyy && out[0] * out[2] > out[1] * out[1])) /* not below that of white residuals */
        out[0] = white * ixx, out[1] = white * ixy, out[2] = white * iyy;
    match->likeness = white > 0.0 ? near / white : 0.0;
    match->noise = sqrt(fmax(white, 0.0));
    for (int k = 0; k < 3; k++) out[k] *= 1.0 + 3.0 * fmin(fmax(match->likeness, 0.0), 1.0); /* part of a mismatch resembles a shift */
}

int lcpf_fit(const lcpf_image *image, lcpf_work *work, lcpf_match *match) {
    lcpf_template *t = &work->shown;
    double x = 0.0, y = 0.0, share = 1.0, last[2] = {0.0, 0.0}, step[3], size = HUGE_VAL;
    match->pixel[0] = match->pixel[1] = match->fit_correlation = match->gain = match->noise = match->likeness = NAN;
    match->covariance[0] = match->covariance[1] = match->covariance[2] = NAN;
    if (t->rows < 1 || t->cols < 1 || image->rows < 1 || image->cols < 1 || !image->fine) return LCPF_ARGUMENT;
    if (match->shift[0] < -2000000 || match->shift[0] > 2000000 || match->shift[1] < -2000000 || match->shift[1] > 2000000)
        return LCPF_ARGUMENT;
    for (int k = 0; k < 16 && !(size < 0.004); k++) {
        blurred(work, x, y, 1);
        if (!(gather(image, t->origin[1] + match->shift[1], t->origin[0] + match->shift[0], work) >= 12.0)) return LCPF_NO_FIT;
        match->fit_correlation = gauss_newton(work, t->rows * t->cols, step);
        share = step[0] * last[0] + step[1] * last[1] < 0.0 ? 0.5 * share : fmin(1.0, 1.5 * share); /* a step back halves them */
        last[0] = step[0], last[1] = step[1], size = hypot(step[0], step[1]);
        x += step[0] * share / fmax(size, 1.0), y += step[1] * share / fmax(size, 1.0);
        if (!(hypot(x, y) < 1.5)) return LCPF_NO_FIT; /* also for NaN */
    }
    if (!(size < 0.05)) return LCPF_NO_FIT;
    match->gain = step[2];
    match->pixel[0] = t->predicted[0] + match->shift[0] + x, match->pixel[1] = t->predicted[1] + match->shift[1] + y;
    covariance(work, match);
    return isfinite(match->covariance[0]) ? LCPF_OK : LCPF_NO_FIT;
}
