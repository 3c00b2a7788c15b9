/* The right-hand side's pixel pass in C, a yardstick of the compiled Python kernels, and STREAM triad.

   Same numbers in, same sums out as ddic.functionals.pixel_kernels.residual_sums for a cubic spline. Images are
   float32, all that is computed from them is REAL, which the compiler is told: double or float. Cell by cell and row by
   row, LANES neighbouring pixels at a time, in gcc's vectors of 64 bytes: which instructions they become is the
   compiler's affair. Pixels beyond a row's end repeat the position of its last one and weigh nothing. Where all pixels
   have one integer offset, as nearly all have, each of the 16 taps is one contiguous load. Sums are kept by lane until
   the cell is done. Nothing is masked and no pixel leaves the image. */

#include <math.h>
#include <stdint.h>
#include <string.h>
#if defined __AVX512F__
#include <immintrin.h>
#endif

enum { LANES = 64 / sizeof(REAL), N_MOMENTS = 8, N_SUMS = 6, LINE = 16, AHEAD = 2 };

typedef REAL vector __attribute__((vector_size(64)));
typedef INTEGER whole __attribute__((vector_size(64)));
typedef float pixels __attribute__((vector_size(4 * LANES), aligned(4)));

/* A window of an image: rows of stride numbers whose first one belongs to pixel (x0, y0), n numbers in all. */
typedef struct {
    const float *values;
    int64_t stride, x0, y0, n;
} image;

/* Geometry X and displacement U on the monomials (1, xi, eta, xi eta), (n_cells, 2, 4), pixels; cell e owns the runs
   row_ptr[e] : row_ptr[e + 1], one a row from first_row[e] on, of columns starts : stops. */
typedef struct {
    int64_t n_visited;
    const int64_t *order;
    const double *X, *U;
    const int64_t *first_row, *row_ptr;
    const int32_t *starts, *stops;
} cell_list;

/* A cell's numbers, relative to its first monomial, divided by e x f: what the loops need. affine: no pixel needs a
   root; one_offset: (whole_x, whole_y) is the integer part of all displacements, which u[0] and v[0] lack then. */
typedef struct {
    REAL e0, e1, f0, f1, g0, g1, a_eta;
    REAL u[4], v[4];
    int affine, one_offset;
    int64_t whole_x, whole_y;
} shape;

/* Whether sum_m D_m phi_m has one integer part in a cell, where no monomial exceeds 1 but for rounding. */
static int has_one_offset(const double *D, int64_t *part)
{
    const double most = (1 + 1e-5) * (fabs(D[1]) + fabs(D[2]) + fabs(D[3]));
    *part = (int64_t)floor(D[0] - most);
    return floor(D[0] + most) == *part;
}

static shape shape_of(const double *X, const double *U)
{
    const double ef = X[1] * X[6] - X[5] * X[2];
    const double e0 = X[1] / ef, f0 = X[2] / ef, g0 = X[3] / ef, e1 = X[5] / ef, f1 = X[6] / ef, g1 = X[7] / ef;
    shape c = {e0, e1, f0, f1, g0, g1, (g0 * f1 - g1 * f0) * ef, {0}, {0}, 0, 0, 0, 0};
    c.one_offset = has_one_offset(U, &c.whole_x) & has_one_offset(U + 4, &c.whole_y);
    for (int k = 0; k < 4; k++) {
        c.u[k] = U[k];
        c.v[k] = U[k + 4];
    }
    if (c.one_offset) {
        c.u[0] = U[0] - c.whole_x;
        c.v[0] = U[4] - c.whole_y;
    }
    c.affine = fabs(g0) + fabs(g1) <= 1e-11 * (fabs(e0) + fabs(e1) + fabs(f0) + fabs(f1));
    return c;
}

/* LANES numbers from *c on. */
static inline vector load(const float *c)
{
#if defined __AVX512F__
    /* gcc 12 converts a vector of 8 in two halves. */
    if (LANES == 8)
        return (vector)_mm512_cvtps_pd(_mm256_loadu_ps(c));
#endif
    return __builtin_convertvector(*(const pixels *)c, vector);
}

static inline vector splat(REAL value)
{
    return value - (vector){0};
}

static inline vector root(vector d)
{
    vector s;
#pragma GCC unroll 1
    for (int k = 0; k < LANES; k++)
        s[k] = SQRT(d[k] > 0 ? d[k] : 0);
    return s;
}

/* u as a whole part and a fraction. */
static inline whole split(vector u, vector *fraction)
{
    whole i = __builtin_convertvector(u, whole);
    i += u < __builtin_convertvector(i, vector);
    *fraction = u - __builtin_convertvector(i, vector);
    return i;
}

/* Local coordinates of pixels at (x, y), relative to the cell's first monomial. */
static inline void invert(const shape *c, vector x, REAL y, vector *xi, vector *eta)
{
    const vector c_eta = x * c->e1 - y * c->e0, c_xi = x * c->f1 - y * c->f0;
    if (c->affine) {
        *xi = c_xi;
        *eta = -c_eta;
        return;
    }
    const vector h = x * c->g1 - y * c->g0, b = 1 + h;
    const vector s = root(b * b - 4 * c->a_eta * c_eta);
    *xi = 2 * c_xi / (1 - h + s);
    *eta = -2 * c_eta / (b + s);
}

static inline vector taps_of_column(const float *c, int64_t stride, vector y0, vector y1, vector y2, vector y3)
{
    const vector r0 = load(c);
    const vector r1 = load(c + stride);
    const vector r2 = load(c + 2 * stride);
    const vector r3 = load(c + 3 * stride);
    return y0 * r0 + y1 * r1 + y2 * r2 + y3 * r3;
}

/* The cubic spline at LANES pixels whose first taps follow each other from c on. */
static inline vector interpolate(const float *c, int64_t stride, vector t, vector s)
{
    const vector u = 1 - t, v = 1 - s;
    const vector x0 = u * u * u, x3 = t * t * t, x1 = 4 - 3 * t * t * (1 + u), x2 = 6 - x0 - x1 - x3;
    const vector y0 = v * v * v, y3 = s * s * s, y1 = 4 - 3 * s * s * (1 + v), y2 = 6 - y0 - y1 - y3;
    const vector g = x0 * taps_of_column(c, stride, y0, y1, y2, y3)
                     + x1 * taps_of_column(c + 1, stride, y0, y1, y2, y3)
                     + x2 * taps_of_column(c + 2, stride, y0, y1, y2, y3)
                     + x3 * taps_of_column(c + 3, stride, y0, y1, y2, y3);
    return g * (REAL)(1.0 / 36.0);
}

/* The same where the array ends before the last lane's taps do: those that there are copied first. */
static __attribute__((noinline)) vector interpolate_last(const image *spline, int64_t at, vector t, vector s)
{
    float taps[4 * (LANES + 3)] = {0};
    for (int j = 0; j < 4; j++)
        for (int64_t k = 0, i = at + j * spline->stride; k < LANES + 3 && i < spline->n; k++, i++)
            taps[j * (LANES + 3) + k] = spline->values[i];
    return interpolate(taps, LANES + 3, t, s);
}

static inline vector interpolate_at(const image *spline, int64_t at, vector t, vector s)
{
    if (at + 3 * spline->stride + LANES + 3 <= spline->n)
        return interpolate(spline->values + at, spline->stride, t, s);
    return interpolate_last(spline, at, t, s);
}

/* g at n pixels, run by run of one integer offset. */
static __attribute__((noinline)) vector interpolate_runs(const image *spline, int64_t at, int n, vector u, vector v)
{
    vector t, s;
    const whole ox = split(u, &t), oy = split(v, &s);
    vector g = {0};
    for (int begin = 0, end; begin < n; begin = end) {
        for (end = begin + 1; end < n && ox[end] == ox[begin] && oy[end] == oy[begin]; end++) {
        }
        const vector some = interpolate_at(spline, at + oy[begin] * spline->stride + ox[begin], t, s);
        for (int k = begin; k < end; k++)
            g[k] = some[k];
    }
    return g;
}

/* LANES numbers from array[at] on; zeros where it ends. */
static inline vector read(const float *array, int64_t at, int64_t n)
{
    if (at + LANES <= n)
        return load(array + at);
    float copy[LANES] = {0};
    memcpy(copy, array + at, (n - at) * sizeof(float));
    return load(copy);
}

static inline double sum_of(vector v)
{
    for (int n = LANES / 2; n > 0; n /= 2)
        for (int k = 0; k < n; k++)
            v[k] += v[k + n];
    return v[0];
}

/* Cells whose pixels are asked for while another one's are worked on, a row after each row: all at once would wait. */
typedef struct {
    int64_t row, n_rows, line, right, down;
} demand;

static demand demand_of(const cell_list *cells, int64_t visit)
{
    if (visit >= cells->n_visited)
        return (demand){0};
    const int64_t e = cells->order[visit], row = cells->row_ptr[e];
    const double *U = cells->U + 8 * e;
    return (demand){row, cells->row_ptr[e + 1] - row, cells->first_row[e], (int64_t)floor(U[0]), (int64_t)floor(U[4])};
}

/* Asks for the next row of what is demanded; of the spline, whose first rows the cell above has needed, for the last
   tap's. */
static inline void fetch_row(demand *of, const cell_list *cells, const image *f, const float *gx, const float *gy,
                             const image *spline)
{
    if (of->n_rows == 0)
        return;
    const int64_t at = (of->line - f->y0) * f->stride - f->x0;
    const int64_t taps = (of->line + of->down + 3 - spline->y0) * spline->stride + of->right - spline->x0;
    for (int64_t x = cells->starts[of->row]; x < cells->stops[of->row] + 2 * LINE - 1; x += LINE) {
        __builtin_prefetch(f->values + at + x, 0, 2);
        __builtin_prefetch(gx + at + x, 0, 2);
        __builtin_prefetch(gy + at + x, 0, 2);
        __builtin_prefetch(spline->values + taps + x, 0, 2);
    }
    of->row++;
    of->line++;
    of->n_rows--;
}

/* Sums over the pixels of cell e: moments (2, 4) of r = f - g(x + u) against grad f, and (1, r, g, r^2, g^2, r g). */
static void add_cell(const cell_list *cells, int64_t e, demand later, const image *f, const float *gx, const float *gy,
                     const image *spline, double *moments, double *sums)
{
    const double *X = cells->X + 8 * e;
    const shape c = shape_of(X, cells->U + 8 * e);
    vector lane;
    for (int k = 0; k < LANES; k++)
        lane[k] = k;
    vector m[N_MOMENTS] = {{0}}, q[N_SUMS] = {{0}};
    for (int64_t row = cells->row_ptr[e]; row < cells->row_ptr[e + 1]; row++) {
        const int64_t line = cells->first_row[e] + row - cells->row_ptr[e], stop = cells->stops[row];
        const REAL y = line - X[4];
        fetch_row(&later, cells, f, gx, gy, spline);
        for (int64_t column = cells->starts[row]; column < stop; column += LANES) {
            const int n = stop - column < LANES ? (int)(stop - column) : LANES;
            const whole inside = lane < splat(n);
            const vector last = splat(n - 1);
            const vector k = (vector)(((whole)lane & inside) | ((whole)last & ~inside));
            vector xi, eta, g;
            invert(&c, (REAL)(column - X[0]) + k, y, &xi, &eta);
            const vector p = xi * eta;
            const vector u = c.u[0] + c.u[1] * xi + c.u[2] * eta + c.u[3] * p;
            const vector v = c.v[0] + c.v[1] * xi + c.v[2] * eta + c.v[3] * p;
            const int64_t taps = (line - spline->y0) * spline->stride + column - spline->x0;
            if (c.one_offset)
                g = interpolate_at(spline, taps + c.whole_y * spline->stride + c.whole_x, u, v);
            else
                g = interpolate_runs(spline, taps, n, u, v);
            const int64_t at = (line - f->y0) * f->stride + column - f->x0;
            const vector r = (vector)((whole)(read(f->values, at, f->n) - g) & inside);
            g = (vector)((whole)g & inside);
            const vector a = r * read(gx, at, f->n), b = r * read(gy, at, f->n);
            m[0] += a, m[1] += a * xi, m[2] += a * eta, m[3] += a * p;
            m[4] += b, m[5] += b * xi, m[6] += b * eta, m[7] += b * p;
            q[0] += (REAL)n / LANES, q[1] += r, q[2] += g, q[3] += r * r, q[4] += g * g, q[5] += r * g;
        }
    }
    while (later.n_rows > 0)
        fetch_row(&later, cells, f, gx, gy, spline);
    for (int i = 0; i < N_MOMENTS; i++)
        moments[i] = sum_of(m[i]);
    for (int i = 0; i < N_SUMS; i++)
        sums[i] = sum_of(q[i]);
}

/* f, gx, gy: of one window; spline: entry (2, 2) belongs to the first pixel of its window, (x0, y0) to entry (1, 1),
   where taps begin; moments: (n_cells, 2, 4); sums: (n_cells, 6). */
void right_hand_side(const cell_list *cells, const image *f, const float *gx, const float *gy, const image *spline,
                     double *moments, double *sums)
{
    for (int64_t visit = 0; visit < cells->n_visited; visit++) {
        const int64_t e = cells->order[visit];
        add_cell(cells, e, demand_of(cells, visit + AHEAD), f, gx, gy, spline, moments + N_MOMENTS * e,
                 sums + N_SUMS * e);
    }
}

void triad(int64_t n, double scale, const double *restrict b, const double *restrict c, double *restrict a)
{
    for (int64_t i = 0; i < n; i++)
        a[i] = b[i] + scale * c[i];
}
