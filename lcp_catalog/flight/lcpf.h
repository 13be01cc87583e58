/* Reference of the flight file (.lcpf): reads it, renders its patches and finds them in an image.
 *
 * C99; needs memcpy and math.h. No allocation, no recursion; every loop is bounded by a limit below or by a size that
 * lcpf_open has checked. Images are single precision, geometry double. Pixels: centres at whole numbers, column first.
 * Positions are metres in the file's Moon-fixed frame; camera axes: X along rows, Y along columns, Z ahead.
 * A function returns LCPF_OK or one of the codes below, and never reads outside what it was given.
 *
 * Licence: Apache-2.0, as lcp-catalog, which describes file and functions (docs/howto/flight.md).
 */
#ifndef LCPF_H
#define LCPF_H

#include <stddef.h>
#include <stdint.h>

/* Limits of the compilation; a larger value costs static memory. State all four, or none. */
#ifndef LCPF_NODES
#define LCPF_NODES 33    /* nodes along a patch's side */
#define LCPF_SIDE 64     /* pixels along a template's side */
#define LCPF_SAMPLES 192 /* samples along a drawing's side: three a pixel, up to eight where a node is below one */
#define LCPF_REACH 64    /* reach of a search, pixels */
#endif
#define LCPF_ROWS 64  /* rows of an image whose sums are held at once; at least LCPF_SIDE */
#define LCPF_TAPS 96  /* samples under a point spread */
#define LCPF_PEAKS 6  /* peaks at half resolution that are followed */
#define LCPF_ALL (LCPF_NODES * LCPF_NODES)
#define LCPF_WIDE (2 * LCPF_REACH + LCPF_SIDE)

enum {
    LCPF_OK = 0,
    LCPF_NOT_A_FILE,  /* no flight file, or another version */
    LCPF_DAMAGED,     /* a checksum or a size is wrong */
    LCPF_TOO_LARGE,   /* beyond a limit of the compilation */
    LCPF_ARGUMENT,    /* an argument is no number, or out of range */
    LCPF_NOT_SEEN,    /* the camera does not see the whole patch */
    LCPF_NOT_LIT,     /* less than 30 % of the patch is lit */
    LCPF_PLAIN,       /* no contrast, or less than 36 pixels */
    LCPF_AT_THE_EDGE, /* less than 30 % of the search area lies in the image, or less than 70 % of the pixels are valid */
    LCPF_NO_PEAK,     /* no correlation above 0 */
    LCPF_NO_FIT       /* the least squares do not converge near the peak */
};

typedef struct {
    const uint8_t *bytes;
    size_t size, tables, numbers, views_at, index, data, stride; /* offsets of the parts, bytes of a point */
    uint32_t points, tiles;
    uint32_t nodes, scales, suns, views, elevations, azimuths, frame, albedo, triangles;
    double min_detection, probability_step, sigma_log_least, sigma_log_step, albedo_sigma, slope_sigma;
} lcpf_file;

typedef struct {
    double position[3], rotation[9]; /* rows: the camera's X, Y, Z in the frame */
    double focal, principal[2];      /* pixels */
    double distortion[5];            /* k1, k2, p1, p2, k3 as OpenCV has them */
    int32_t width, height;
    double sun[3];                   /* position of the Sun */
} lcpf_camera;

typedef struct {
    int64_t id;
    double position[3], rotation[9]; /* rows east, north, up */
    double gsd, elevation_sigma;     /* metres; the sigma is NaN where unknown */
    int32_t nodes, level;
    float height[LCPF_ALL], albedo[LCPF_ALL];
} lcpf_point;

typedef struct {
    uint32_t point;     /* its number in the file */
    double pixel[2];    /* where the camera projects it */
    double pixel_size;  /* metres */
    int32_t usable;     /* 1: claimed usable; 0: not, or no claim (probability NaN) */
    double probability; /* of detection */
    double sigma_major, sigma_minor, angle; /* metres; clockwise from north, degrees */
} lcpf_claim;

/* Reflectance: Lommel-Seeliger (numbers: albedo) or lunar-Lambert (scale, B0, h, c, asymmetry). */
typedef struct {
    int32_t lunar_lambert;
    double number[5];
} lcpf_law;

extern const lcpf_law LCPF_LOMMEL_SEELIGER, LCPF_LUNAR_LAMBERT;

/* Pixels less their mean, row by row, gaps filled; weights 0 (gap) to 1, or NULL; both at half size by lcpf_half. */
typedef struct {
    const float *fine, *weight, *half, *half_weight;
    int32_t rows, cols; /* of the full image; of the half one rows / 2, cols / 2 */
} lcpf_image;

typedef struct {
    int32_t rows, cols, sub; /* samples along a pixel's side */
    int32_t origin[2];       /* the image's column and row of its first pixel */
    double predicted[2];     /* pixel of the patch's centre */
    double sigma;            /* of the point spread, pixels */
    int32_t count;           /* pixels on the patch */
    float value[LCPF_SIDE * LCPF_SIDE];
    uint8_t mask[LCPF_SIDE * LCPF_SIDE];
    float drawing[LCPF_SAMPLES * LCPF_SAMPLES]; /* sample s of column c of a row lies at s * cols + c */
    float known[LCPF_SAMPLES * LCPF_SAMPLES];   /* 1 where the patch is seen, else 0 */
} lcpf_template;

typedef struct {
    int32_t shift[2];           /* pixels right and down of where it is expected */
    double correlation, second; /* of the highest peak, and of the highest one away from it (NaN: none) */
    double pixel[2];            /* the place found */
    double covariance[3];       /* xx, xy, yy, px^2 */
    double fit_correlation, gain, noise, likeness; /* of the fit; correlation of neighbouring residuals */
} lcpf_match;

/* Memory of render, search and fit; one for each thread. */
typedef struct {
    lcpf_template shown;
    union {
        struct {
            float light[LCPF_ALL], clear[LCPF_ALL];
            double x[LCPF_ALL], y[LCPF_ALL], far[LCPF_ALL];
        } draw;
        struct {
            float cut[LCPF_SIDE * LCPF_SIDE], small[LCPF_SIDE * LCPF_SIDE];
            uint8_t mask[LCPF_SIDE * LCPF_SIDE], inside[LCPF_SIDE * LCPF_SIDE];
            float region[LCPF_ROWS * LCPF_WIDE];
            double one[LCPF_ROWS * (LCPF_WIDE + 1)], two[LCPF_ROWS * (LCPF_WIDE + 1)];
            float real[LCPF_ROWS * (LCPF_WIDE + 1)];
            float score[(2 * LCPF_REACH + 1) * (2 * LCPF_REACH + 1)];
        } search;
        struct {
            float seen[4][LCPF_SIDE * LCPF_SIDE];
            double light[LCPF_SIDE * LCPF_SIDE], w[LCPF_SIDE * LCPF_SIDE], rest[LCPF_SIDE * LCPF_SIDE];
            float line[LCPF_SAMPLES];
        } fit;
    } u;
} lcpf_work;

/* Check header, tables and index of a file in memory, which must stay there. Its points are checked by tile. */
int lcpf_open(lcpf_file *file, const uint8_t *bytes, size_t size);
/* Check the points of one tile; of all. */
int lcpf_check_tile(const lcpf_file *file, uint32_t tile);
int lcpf_check(const lcpf_file *file);

/* Decode a point. */
int lcpf_load(const lcpf_file *file, uint32_t number, lcpf_point *point);

/* Pixel of a position: 1 if the camera sees it, else 0. */
int lcpf_project(const lcpf_camera *camera, const double position[3], double pixel[2]);

/* The points in view of a camera with their claims; of more than `most`, those with the highest probability. Tiles outside
 * the image are skipped, the others checked first. Claims are interpolated between Suns, views and image scales. */
int lcpf_in_view(const lcpf_file *file, const lcpf_camera *camera, lcpf_claim *claims, uint32_t most, uint32_t *count);

/* Render a point's patch into work->shown; sigma: Gaussian point spread, pixels (0 to 1); 0.5, or 0.5/r of an image reduced r times. */
int lcpf_render(const lcpf_point *point, const lcpf_camera *camera, const lcpf_law *law, double sigma, lcpf_work *work);

/* Means of 2 x 2 pixels, rows / 2 by cols / 2. */
void lcpf_half(const float *fine, int32_t rows, int32_t cols, float *half);

/* Search for work->shown within reach pixels of where it is expected plus offset; then fit it. */
int lcpf_search(const lcpf_image *image, const int32_t offset[2], int32_t reach, lcpf_work *work, lcpf_match *match);
int lcpf_fit(const lcpf_image *image, lcpf_work *work, lcpf_match *match);

#endif
