/* Damaged files and images for lcpf.c, to be run under sanitizers:
 *
 *     lcpf_fuzz site.lcpf FILES IMAGES [SEED]
 *
 * Half of the damaged files get right checksums, so that wrong numbers reach the code behind them. Every call must return. */
#include "lcpf.c"

#include <stdio.h>
#include <stdlib.h>

#define SIDE 150

static uint64_t state = 88172645463325252u;
static lcpf_work work;
static lcpf_point point;
static lcpf_claim claims[64];
static float fine[SIDE * SIDE], half[SIDE * SIDE / 4], weight[SIDE * SIDE], half_weight[SIDE * SIDE / 4];

static uint64_t next(void) {
    state ^= state << 13, state ^= state >> 7, state ^= state << 17;
    return state;
}

static uint32_t below(uint32_t n) { return (uint32_t)(next() >> 33) % n; }
static double uniform(double low, double high) { return low + (high - low) * (double)(next() >> 11) / 9007199254740992.0; }

static double odd(void) {
    static const double values[9] = {0.0, -1.0, 1e-300, 1e300, -1e300, 1e9, 3e38, 0.5, 1.0};
    uint32_t k = below(12);
    return k < 9 ? values[k] : k == 9 ? NAN : k == 10 ? HUGE_VAL : -HUGE_VAL;
}

static void put32(uint8_t *p, uint32_t value) {
    for (int k = 0; k < 4; k++) p[k] = (uint8_t)(value >> 8 * k);
}

/* Right checksums and a right size, as far as the parts lie within the file. */
static void sign(uint8_t *b, size_t size) {
    if (size < HEADER) return;
    put32(b + 16, (uint32_t)size), put32(b + 20, 0);
    size_t e = u16(b + 44), a = u16(b + 46), tables = 4u * (e + a + 3u * u16(b + 42) + u16(b + 38)) + 2u * e * a + 3u * u16(b + 132);
    tables += (8u - tables % 8u) % 8u;
    size_t index = HEADER + tables, tiles = u32(b + 28), data = index + TILE * tiles;
    if (data <= size) {
        for (size_t t = 0; t < tiles; t++) {
            uint8_t *p = b + index + TILE * t;
            size_t first = data + (size_t)u32(b + 32) * u32(p + 28), count = (size_t)u32(b + 32) * u32(p + 32);
            if (first <= size && count <= size - first) put32(p + 36, crc32(b + first, count));
        }
        put32(b + 52, crc32(b + HEADER, tables)), put32(b + 56, crc32(b + index, data - index));
    }
    put32(b + HEADER - 4, crc32(b, HEADER - 4));
}

/* A camera above a point, mostly a sensible one. */
static lcpf_camera camera_over(const double place[3]) {
    lcpf_camera c = {{0}, {0}, uniform(100.0, 3000.0), {74.5, 74.5}, {0}, SIDE, SIDE, {0}};
    double up[3], right[3], length = sqrt(dot3(place, place)), range = uniform(2e3, 2e5), axis[3] = {0.2, 0.9, 0.4};
    for (int k = 0; k < 3; k++) up[k] = place[k] / length + uniform(-0.4, 0.4);
    length = sqrt(dot3(up, up));
    for (int k = 0; k < 3; k++) up[k] /= length, c.position[k] = place[k] + range * up[k], c.rotation[6 + k] = -up[k];
    for (int k = 0; k < 3; k++) right[k] = axis[(k + 1) % 3] * up[(k + 2) % 3] - axis[(k + 2) % 3] * up[(k + 1) % 3];
    length = sqrt(dot3(right, right));
    for (int k = 0; k < 3; k++) c.rotation[k] = right[k] / length;
    for (int k = 0; k < 3; k++) /* Y = Z x X */
        c.rotation[3 + k] = c.rotation[6 + (k + 1) % 3] * c.rotation[(k + 2) % 3] - c.rotation[6 + (k + 2) % 3] * c.rotation[(k + 1) % 3];
    for (int k = 0; k < 3; k++) c.sun[k] = 1.5e11 * (up[k] + uniform(-3.0, 3.0));
    c.focal = range * uniform(0.003, 0.02);
    if (below(4) == 0)
        for (int k = 0; k < 5; k++) c.distortion[k] = uniform(-0.3, 0.3);
    double *numbers[5] = {c.position, c.rotation, c.distortion, c.sun, c.principal};
    if (below(8) == 0) *(below(6) ? numbers[below(5)] + below(2) : &c.focal) = odd();
    return c;
}

static void files(const uint8_t *good, size_t size, long rounds, long code[16]) {
    for (long k = 0; k < rounds; k++) {
        size_t length = below(8) == 0 ? below((uint32_t)size + 1) : size;
        uint8_t *copy = malloc(length ? length : 1); /* of its own size: a byte beyond is found */
        lcpf_file file;
        if (!copy) exit(2);
        memcpy(copy, good, length);
        uint32_t changes = 1 + below(6), part = below(3) ? below(2) ? HEADER : 1200u : (uint32_t)size;
        for (uint32_t i = 0; length && i < changes; i++) copy[below(part) % length] = (uint8_t)(below(3) ? next() : below(2) * 255u);
        if (below(2)) sign(copy, length);
        int found = lcpf_open(&file, copy, length);
        if (!found) {
            uint32_t count = 0, number = below(file.points ? file.points : 1);
            found = lcpf_check(&file);
            if (!lcpf_load(&file, number, &point)) {
                lcpf_camera camera = camera_over(point.position);
                lcpf_in_view(&file, &camera, claims, 1 + below(64), &count);
                if (below(16) == 0) lcpf_render(&point, &camera, below(2) ? &LCPF_LUNAR_LAMBERT : &LCPF_LOMMEL_SEELIGER, 0.5, &work);
            }
        }
        code[found]++;
        free(copy);
    }
}

static void images(const lcpf_file *file, long rounds, long code[16]) {
    for (long k = 0; k < rounds; k++) {
        lcpf_image image = {fine, below(2) ? weight : NULL, half, half_weight, SIDE - (int32_t)below(149), SIDE - (int32_t)below(149)};
        if (!image.weight) image.half_weight = NULL;
        int kind = (int)below(5), found = lcpf_load(file, below(file->points), &point);
        lcpf_camera camera = camera_over(point.position);
        lcpf_match match = {0};
        int32_t offset[2] = {(int32_t)below(41) - 20, (int32_t)below(41) - 20};
        double amplitude = pow(10.0, uniform(-30.0, 30.0));
        if (below(50) == 0) offset[below(2)] = (int32_t)next();
        if (!found) found = lcpf_render(&point, &camera, below(2) ? &LCPF_LUNAR_LAMBERT : &LCPF_LOMMEL_SEELIGER, uniform(0.0, 1.0), &work);
        for (int32_t i = 0; i < SIDE * SIDE; i++) {
            fine[i] = kind == 0 ? 0.0f : (float)(amplitude * uniform(-1.0, 1.0)), weight[i] = (float)(below(8) ? 1.0 : uniform(0.0, 1.0));
            int32_t r = i / image.cols - work.shown.origin[1], c = i % image.cols - work.shown.origin[0];
            if (kind > 1 && r >= 0 && r < work.shown.rows && c >= 0 && c < work.shown.cols) /* the template, with noise */
                fine[i] = work.shown.value[r * work.shown.cols + c] * (float)amplitude + 0.01f * fine[i];
        }
        for (uint32_t i = below(3) ? 0 : below(40); i > 0; i--) fine[below(SIDE * SIDE)] = (float)odd(), weight[below(SIDE * SIDE)] = 0.0f;
        lcpf_half(fine, image.rows, image.cols, half), lcpf_half(weight, image.rows, image.cols, half_weight);
        if (!found) found = lcpf_search(&image, offset, 1 + (int32_t)below(below(8) ? 24 : LCPF_REACH + 2), &work, &match);
        if (!found || below(4) == 0) found = lcpf_fit(&image, &work, &match);
        code[found]++;
    }
}

int main(int argc, char **argv) {
    static uint8_t content[4000000];
    FILE *file = argc > 3 ? fopen(argv[1], "rb") : NULL;
    size_t size = file ? fread(content, 1, sizeof content, file) : 0;
    long code[2][16] = {{0}};
    lcpf_file site;
    if (file) fclose(file);
    if (argc < 4) return fprintf(stderr, "usage: lcpf_fuzz site.lcpf FILES IMAGES [SEED]\n"), 2;
    if (size == sizeof content || lcpf_open(&site, content, size) || lcpf_check(&site))
        return fprintf(stderr, "%s: is no whole flight file below 4 MB\n", argv[1]), 2;
    if (argc > 4) state += 2654435761u * (uint64_t)atol(argv[4]);
    files(content, size, atol(argv[2]), code[0]);
    images(&site, atol(argv[3]), code[1]);
    for (int k = 0; k < 2; k++) {
        printf("%s by code:", k ? "images" : "files");
        for (int i = 0; i < 11; i++) printf(" %ld", code[k][i]);
        printf("\n");
    }
    return 0;
}
