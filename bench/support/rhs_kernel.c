/* The right-hand side's pixel pass in plain C, and STREAM triad, as yardsticks of the compiled Python kernels.

   Same numbers in, same sums out as ddic.functionals.pixel_kernels.residual_sums for a cubic spline: float32 images,
   float64 positions, interpolation and sums. Cell by cell, row by row; pixels of a row with one integer offset read
   coefficients contiguously. Nothing is masked and no pixel leaves the image. */

#include <math.h>
#include <stdint.h>

enum { CHUNK = 256 };

static void coordinates(const double *X, int64_t x0, int64_t y, int n, double *restrict xi, double *restrict eta)
{
    const double e0 = X[1], f0 = X[2], g0 = X[3], e1 = X[5], f1 = X[6], g1 = X[7];
    const double h0 = x0 - X[0], h1 = y - X[4], ef = e0 * f1 - e1 * f0;
    if (fabs(g0) + fabs(g1) <= 1e-11 * (fabs(e0) + fabs(e1) + fabs(f0) + fabs(f1))) {
        const double p = (f1 * h0 - f0 * h1) / ef, dp = f1 / ef, q = (e0 * h1 - e1 * h0) / ef, dq = -e1 / ef;
        for (int k = 0; k < n; k++) {
            xi[k] = p + dp * k;
            eta[k] = q + dq * k;
        }
        return;
    }
    const double a = g0 * f1 - g1 * f0;
    for (int k = 0; k < n; k++) {
        const double h = h0 + k, b = ef + h * g1 - h1 * g0, c = h * e1 - h1 * e0;
        const double d = b * b - 4.0 * a * c;
        const double t = 2.0 * c / (-b - sqrt(d > 0.0 ? d : 0.0));
        const double p0 = e0 + g0 * t, p1 = e1 + g1 * t;
        xi[k] = ((h - f0 * t) * p0 + (h1 - f1 * t) * p1) / (p0 * p0 + p1 * p1);
        eta[k] = t;
    }
}

static void cubic_run(const float *restrict c, int64_t stride, int n, const double *restrict tx,
                      const double *restrict ty, double *restrict g)
{
    const float *r0 = c, *r1 = c + stride, *r2 = c + 2 * stride, *r3 = c + 3 * stride;
    for (int k = 0; k < n; k++) {
        const double t = tx[k], s = ty[k], u = 1.0 - t, v = 1.0 - s;
        const double x0 = u * u * u, x3 = t * t * t, x1 = 4.0 - 3.0 * t * t * (1.0 + u), x2 = 6.0 - x0 - x1 - x3;
        const double y0 = v * v * v, y3 = s * s * s, y1 = 4.0 - 3.0 * s * s * (1.0 + v), y2 = 6.0 - y0 - y1 - y3;
        const double a0 = y0 * r0[k] + y1 * r1[k] + y2 * r2[k] + y3 * r3[k];
        const double a1 = y0 * r0[k + 1] + y1 * r1[k + 1] + y2 * r2[k + 1] + y3 * r3[k + 1];
        const double a2 = y0 * r0[k + 2] + y1 * r1[k + 2] + y2 * r2[k + 2] + y3 * r3[k + 2];
        const double a3 = y0 * r0[k + 3] + y1 * r1[k + 3] + y2 * r2[k + 3] + y3 * r3[k + 3];
        g[k] = (x0 * a0 + x1 * a1 + x2 * a2 + x3 * a3) * (1.0 / 36.0);
    }
}

/* X, U: (n_cells, 2, 4); f, gx, gy: rows of f_width pixels from (fx0, fy0); spline: rows of stride coefficients whose
   entry (2, 2) belongs to pixel (sx0, sy0); moments: (n_cells, 2, 4) of r; sums: (n_cells, 6). */
void right_hand_side(int64_t n_cells, const double *X, const double *U, const int64_t *first_row,
                     const int64_t *row_ptr, const int32_t *starts, const int32_t *stops, const float *f,
                     const float *gx, const float *gy, int64_t f_width, int64_t fx0, int64_t fy0,
                     const float *spline, int64_t stride, int64_t sx0, int64_t sy0, double *moments, double *sums)
{
    double xi[CHUNK], eta[CHUNK], tx[CHUNK], ty[CHUNK], g[CHUNK];
    int ox[CHUNK], oy[CHUNK];
    for (int64_t e = 0; e < n_cells; e++) {
        const double *u = U + 8 * e, *v = u + 4;
        double m[8] = {0}, q[6] = {0};
        for (int64_t row = row_ptr[e]; row < row_ptr[e + 1]; row++) {
            const int64_t y = first_row[e] + row - row_ptr[e];
            for (int64_t x0 = starts[row]; x0 < stops[row]; x0 += CHUNK) {
                const int n = stops[row] - x0 < CHUNK ? (int)(stops[row] - x0) : CHUNK;
                coordinates(X + 8 * e, x0, y, n, xi, eta);
                for (int k = 0; k < n; k++) {
                    const double p = xi[k] * eta[k];
                    const double ux = u[0] + u[1] * xi[k] + u[2] * eta[k] + u[3] * p;
                    const double uy = v[0] + v[1] * xi[k] + v[2] * eta[k] + v[3] * p;
                    const double bx = floor(ux), by = floor(uy);
                    ox[k] = (int)bx;
                    oy[k] = (int)by;
                    tx[k] = ux - bx;
                    ty[k] = uy - by;
                }
                for (int begin = 0, end; begin < n; begin = end) {
                    for (end = begin + 1; end < n && ox[end] == ox[begin] && oy[end] == oy[begin]; end++) {
                    }
                    cubic_run(spline + (y + oy[begin] - sy0 + 1) * stride + x0 + begin + ox[begin] - sx0 + 1, stride,
                              end - begin, tx + begin, ty + begin, g + begin);
                }
                const int64_t at = (y - fy0) * f_width + x0 - fx0;
                double m0 = 0, m1 = 0, m2 = 0, m3 = 0, m4 = 0, m5 = 0, m6 = 0, m7 = 0;
                double q1 = 0, q2 = 0, q3 = 0, q4 = 0, q5 = 0;
                for (int k = 0; k < n; k++) {
                    const double r = f[at + k] - g[k], a = r * gx[at + k], b = r * gy[at + k];
                    const double t = xi[k], s = eta[k];
                    m0 += a;
                    m1 += a * t;
                    m2 += a * s;
                    m3 += a * t * s;
                    m4 += b;
                    m5 += b * t;
                    m6 += b * s;
                    m7 += b * t * s;
                    q1 += r;
                    q2 += g[k];
                    q3 += r * r;
                    q4 += g[k] * g[k];
                    q5 += r * g[k];
                }
                m[0] += m0, m[1] += m1, m[2] += m2, m[3] += m3, m[4] += m4, m[5] += m5, m[6] += m6, m[7] += m7;
                q[0] += n, q[1] += q1, q[2] += q2, q[3] += q3, q[4] += q4, q[5] += q5;
            }
        }
        for (int i = 0; i < 8; i++)
            moments[8 * e + i] = m[i];
        for (int i = 0; i < 6; i++)
            sums[6 * e + i] = q[i];
    }
}

void triad(int64_t n, double scale, const double *restrict b, const double *restrict c, double *restrict a)
{
    for (int64_t i = 0; i < n; i++)
        a[i] = b[i] + scale * c[i];
}
