/* Example of lcpf.h: the points of a frame, each rendered, searched and fitted, and the camera's position from them.
 *
 *     lcpf_example site.lcpf camera.txt frame.pgm [expected.txt]
 *
 * camera.txt: 23 numbers: position (3), rotation (9), focal length, principal point (2), distortion (5), Sun (3).
 * frame.pgm: 8 bits, binary. expected.txt: lines `id column row`, then `position x y z sigma`; exit code 1 if a place differs
 * by more than 0.02 px or the position by more than 0.05 sigma. */
#include "lcpf.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define POINTS 150
#define FILE_BYTES 4000000
#define PIXELS 4200000

static uint8_t content[FILE_BYTES], grey[PIXELS];
static float fine[PIXELS], half[PIXELS / 4];
static lcpf_claim claims[POINTS];
static lcpf_point point;
static lcpf_work work;

/* The camera moved by three metres and turned about its own axes by a vector of radians. */
static lcpf_camera moved(const lcpf_camera *camera, const double six[6]) {
    lcpf_camera out = *camera;
    double angle = sqrt(six[3] * six[3] + six[4] * six[4] + six[5] * six[5]), k[3] = {0.0, 0.0, 0.0};
    for (int i = 0; i < 3; i++) out.position[i] += six[i], k[i] = angle > 0.0 ? six[3 + i] / angle : 0.0;
    for (int j = 0; j < 3; j++) { /* Rodrigues: each column v becomes v cos + k x v sin + k (k v)(1 - cos) */
        double v[3] = {camera->rotation[j], camera->rotation[3 + j], camera->rotation[6 + j]};
        double along = k[0] * v[0] + k[1] * v[1] + k[2] * v[2];
        double turn[3] = {k[1] * v[2] - k[2] * v[1], k[2] * v[0] - k[0] * v[2], k[0] * v[1] - k[1] * v[0]};
        for (int i = 0; i < 3; i++)
            out.rotation[3 * i + j] = v[i] * cos(angle) + turn[i] * sin(angle) + k[i] * along * (1.0 - cos(angle));
    }
    return out;
}

/* Inverse of a positive symmetric matrix (6, 6), with its rows and columns scaled; 0 if it is not positive. */
static int inverse6(double m[6][6], double out[6][6]) {
    double size[6], l[6][6] = {{0}}, b[6][6] = {{0}};
    for (int i = 0; i < 6; i++)
        if (!((size[i] = sqrt(m[i][i])) > 0.0)) return 0;
    for (int i = 0; i < 6; i++)
        for (int j = 0; j <= i; j++) {
            double sum = m[i][j] / (size[i] * size[j]);
            for (int k = 0; k < j; k++) sum -= l[i][k] * l[j][k];
            if (i == j && !(sum > 1e-13)) return 0;
            l[i][j] = i == j ? sqrt(sum) : sum / l[j][j];
        }
    for (int c = 0; c < 6; c++) /* b = inverse of l */
        for (int i = c; i < 6; i++) {
            double sum = i == c ? 1.0 : 0.0;
            for (int k = c; k < i; k++) sum -= l[i][k] * b[k][c];
            b[i][c] = sum / l[i][i];
        }
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            out[i][j] = 0.0;
            for (int k = 0; k < 6; k++) out[i][j] += b[k][i] * b[k][j] / (size[i] * size[j]);
        }
    return 1;
}

/* Weighted least squares: the camera from n places and their covariances (xx, xy, yy), without a prior; the covariance of its
 * position and attitude, times chi2 over its expectation where that is above 1. Returns LCPF_OK or LCPF_NO_FIT. */
int example_position(const lcpf_camera *camera, double (*position)[3], double (*pixel)[2], double (*covariance)[3], int32_t n,
                     lcpf_camera *solved, double out[6][6]) {
    double step[6], total = 0.0, range = 0.0;
    *solved = *camera;
    for (int k = 0; n > 0 && k < 3; k++) range += pow(camera->position[k] - position[0][k], 2);
    for (int k = 0; k < 6; k++) step[k] = 0.1 * (k < 3 ? sqrt(range) : 1.0) / camera->focal;
    for (int round = 0; round < 20; round++) {
        double normal[6][6] = {{0}}, right[6] = {0}, largest = 0.0, change[6];
        total = 0.0;
        for (int32_t i = 0; i < n; i++) {
            double here[2], ahead[2], behind[2], slope[6][2], *c = covariance[i], det = c[0] * c[2] - c[1] * c[1];
            if (!lcpf_project(solved, position[i], here) || !(det > 0.0)) return LCPF_NO_FIT;
            for (int k = 0; k < 6; k++) {
                double one[6] = {0};
                one[k] = step[k];
                lcpf_camera more = moved(solved, one);
                one[k] = -step[k];
                lcpf_camera less = moved(solved, one);
                if (!lcpf_project(&more, position[i], ahead) || !lcpf_project(&less, position[i], behind)) return LCPF_NO_FIT;
                for (int a = 0; a < 2; a++) slope[k][a] = (ahead[a] - behind[a]) / (2.0 * step[k]);
            }
            double x = pixel[i][0] - here[0], y = pixel[i][1] - here[1];
            total += (c[2] * x * x - 2.0 * c[1] * x * y + c[0] * y * y) / det;
            for (int k = 0; k < 6; k++) {
                double u = (c[2] * slope[k][0] - c[1] * slope[k][1]) / det, v = (c[0] * slope[k][1] - c[1] * slope[k][0]) / det;
                right[k] += u * x + v * y;
                for (int j = 0; j < 6; j++) normal[k][j] += u * slope[j][0] + v * slope[j][1];
            }
        }
        if (!inverse6(normal, out)) return LCPF_NO_FIT;
        for (int k = 0; k < 6; k++) {
            change[k] = 0.0;
            for (int j = 0; j < 6; j++) change[k] += out[k][j] * right[j];
            largest = fmax(largest, fabs(change[k]) / sqrt(out[k][k]));
        }
        *solved = moved(solved, change);
        if (largest < 1e-6) break;
    }
    double scale = n > 3 ? fmax(1.0, total / (2.0 * n - 6.0)) : 1.0;
    for (int k = 0; k < 36; k++) out[k / 6][k % 6] *= scale;
    return LCPF_OK;
}

static size_t read_file(const char *name, uint8_t *out, size_t most) {
    FILE *file = fopen(name, "rb");
    size_t count = file ? fread(out, 1, most, file) : 0;
    if (file) fclose(file);
    return count;
}

static int read_camera(const char *name, lcpf_camera *camera) {
    double n[23];
    FILE *file = fopen(name, "r");
    int count = 0;
    while (file && count < 23 && fscanf(file, "%lf", n + count) == 1) count++;
    if (file) fclose(file);
    memcpy(camera->position, n, sizeof camera->position), memcpy(camera->rotation, n + 3, sizeof camera->rotation);
    camera->focal = n[12], memcpy(camera->principal, n + 13, sizeof camera->principal);
    memcpy(camera->distortion, n + 15, sizeof camera->distortion), memcpy(camera->sun, n + 20, sizeof camera->sun);
    return count == 23;
}

/* An image less its mean, and its half-size copy. */
static int read_image(const char *name, lcpf_camera *camera, lcpf_image *image) {
    int width = 0, height = 0;
    double mean = 0.0;
    FILE *file = fopen(name, "rb");
    int good = file && fscanf(file, "P5 %d %d 255", &width, &height) == 2 && width > 0 && height > 0 && width <= PIXELS / height;
    size_t count = good ? (size_t)width * (size_t)height : 0;
    good = good && fgetc(file) != EOF && fread(grey, 1, count, file) == count;
    if (file) fclose(file);
    for (size_t k = 0; good && k < count; k++) mean += grey[k] / (double)count;
    for (size_t k = 0; good && k < count; k++) fine[k] = (float)(grey[k] - mean);
    if (good) lcpf_half(fine, height, width, half);
    camera->width = width, camera->height = height;
    *image = (lcpf_image){fine, NULL, half, NULL, height, width};
    return good;
}

int main(int argc, char **argv) {
    static double position[POINTS][3], pixel[POINTS][2], covariance[POINTS][3];
    static int64_t id[POINTS];
    lcpf_file site;
    lcpf_camera camera, solved;
    lcpf_image image;
    uint32_t count = 0;
    int32_t n = 0, wrong = 0, compared = 0;
    double six[6][6], worst = 0.0;
    if (argc < 4) return fprintf(stderr, "usage: lcpf_example site.lcpf camera.txt frame.pgm [expected.txt]\n"), 2;
    const size_t size = read_file(argv[1], content, sizeof content);
    int code = size < sizeof content ? lcpf_open(&site, content, size) : LCPF_TOO_LARGE;
    if (code)
        return fprintf(stderr, "%s: is no flight file, is damaged, or is 4 MB or larger (code %d of lcpf.h)\n", argv[1], code), 2;
    if (!read_camera(argv[2], &camera)) return fprintf(stderr, "%s: is no camera of the example\n", argv[2]), 2;
    if (!read_image(argv[3], &camera, &image)) return fprintf(stderr, "%s: is no PGM image of the camera's size\n", argv[3]), 2;
    if ((code = lcpf_in_view(&site, &camera, claims, POINTS, &count)) != 0)
        return fprintf(stderr, "%s: the points in view cannot be read (code %d of lcpf.h)\n", argv[1], code), 2;
    for (uint32_t k = 0; k < count; k++) {
        const int32_t offset[2] = {0, 0};
        lcpf_match match;
        code = lcpf_load(&site, claims[k].point, &point);
        if (!code) code = lcpf_render(&point, &camera, &LCPF_LUNAR_LAMBERT, 0.5, &work);
        if (!code) code = lcpf_search(&image, offset, 16, &work, &match);
        if (!code) code = lcpf_fit(&image, &work, &match);
        printf("%lld code %d", (long long)point.id, code);
        if (!code)
            printf(" found %.4f %.4f by the camera %.4f %.4f sigma %.4f %.4f correlation %.3f second %.3f", match.pixel[0], match.pixel[1],
                   claims[k].pixel[0], claims[k].pixel[1], sqrt(match.covariance[0]), sqrt(match.covariance[2]),
                   match.fit_correlation, match.second);
        printf(" claimed %.3f\n", claims[k].probability);
        /* a rule for the example only: which matches to believe is the filter's decision */
        if (code || !(match.fit_correlation > 0.8) || match.second > match.fit_correlation - 0.1) continue;
        memcpy(position[n], point.position, sizeof position[n]), memcpy(pixel[n], match.pixel, sizeof pixel[n]);
        memcpy(covariance[n], match.covariance, sizeof covariance[n]), id[n++] = point.id;
    }
    code = example_position(&camera, position, pixel, covariance, n, &solved, six);
    if (code) return fprintf(stderr, "%d matches do not determine the position\n", (int)n), 1;
    double sigma = sqrt(six[0][0] + six[1][1] + six[2][2]);
    printf("position %.3f %.3f %.3f sigma %.3f from %d matches\n", solved.position[0], solved.position[1], solved.position[2], sigma, (int)n);
    FILE *file = argc > 4 ? fopen(argv[4], "r") : NULL;
    if (argc > 4 && !file) return fprintf(stderr, "%s: cannot be read\n", argv[4]), 2;
    for (long long which; file && fscanf(file, "%lld", &which) == 1; compared++) {
        double x, y, off = HUGE_VAL;
        if (fscanf(file, "%lf %lf", &x, &y) != 2) break;
        for (int32_t k = 0; k < n; k++)
            if (id[k] == which) off = hypot(pixel[k][0] - x, pixel[k][1] - y);
        worst = fmax(worst, off), wrong += !(off <= 0.02);
    }
    double p[4] = {0};
    if (!file) return 0;
    if (fscanf(file, " position %lf %lf %lf %lf", p, p + 1, p + 2, p + 3) != 4 || compared != n) wrong++;
    fclose(file);
    double off = sqrt(pow(p[0] - solved.position[0], 2) + pow(p[1] - solved.position[1], 2) + pow(p[2] - solved.position[2], 2));
    wrong += !(off <= 0.05 * p[3]);
    printf("%s: %d of %d places, largest difference %.4f px; position differs by %.4f sigma\n", wrong ? "FAILED" : "passed", (int)compared,
           (int)n, worst, off / p[3]);
    return wrong != 0;
}
