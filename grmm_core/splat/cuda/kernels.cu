// The rasteriser as CUDA kernels. `compile.py` compiles this text at run time with NVRTC; no nvcc and no CUDA headers are needed.
//
// Capital names that are not defined here are constants of `rules.py` and sizes, which `source.py` defines in front of this text.
// The mathematics is that of `reference.py`; the records, the gradients by moments and the replay from front to back are those
// of `cpu/` (projection.py, forward.py, backward.py), where they are explained. One block of 256 threads draws one 16 x 16 tile.
//
// The tests also compile this text with a C++ compiler, under stand-ins for CUDA's built-ins, and hold it to the reference.

typedef long long int64;

const unsigned ALL_LANES = 0xffffffffu;

// A camera as 24 doubles, in this order.
struct Camera {
    double rotation[9];  // world to camera, by rows
    double translation[3];
    double fx, fy, cx, cy;
    double low_u, high_u, low_v, high_v;  // bounds of the point at which the perspective is expanded
    double width, height;
    double orthographic, antialiased;  // not 0: yes
};

// A projected Gaussian, RECORD floats.
struct Record {
    float x, y;           // centre, pixels
    float l11, l12, l22;  // -ln(alpha / opacity) = (s^2 + q^2) / 2 with s = l11 dx + l12 dy, q = l22 dy
    float opacity;        // after compensation
    float red, green, blue;
    float depth;
    unsigned first, end;  // tiles x | y << 16 of the first and of one past the last one
};

// What projection and its gradient both need of one Gaussian.
struct Expansion {
    double x, y, z;                    // camera coordinates
    double quat[4], inverse_norm;      // unit quaternion
    double turn[3][3], axes[3][3];     // its rotation; the same with columns times the scales
    double j00, j02, j11, j12;         // Jacobian of the projection
    double u, v, bounded_u, bounded_v; // x / z, y / z
    double to_plane[2][3];             // Jacobian times camera rotation
    double half[2][3];                 // to_plane times axes: the covariance is half half^T
    double a, b, c, det, det_dilated;  // covariance without dilation
};

__device__ inline double bound(double value, double low, double high) {
    return value < low ? low : value > high ? high : value;
}

__device__ inline bool is_finite(double value) {
    return value - value == 0.0;
}

// Returns whether the Gaussian is in front of the camera and has finite numbers and a rotation.
__device__ inline bool expand(const float *mean, const float *quat, const float *scale, const Camera &camera, Expansion &e) {
    const double *r = camera.rotation;
    double total = 0.0, norm = 0.0;
    for (int i = 0; i < 3; ++i) total += ((double)mean[i] + (double)scale[i]) * 0.0;
    for (int i = 0; i < 4; ++i) norm += (double)quat[i] * (double)quat[i];
    e.x = r[0] * mean[0] + r[1] * mean[1] + r[2] * mean[2] + camera.translation[0];
    e.y = r[3] * mean[0] + r[4] * mean[1] + r[5] * mean[2] + camera.translation[1];
    e.z = r[6] * mean[0] + r[7] * mean[1] + r[8] * mean[2] + camera.translation[2];
    if (!(total == 0.0 && norm > 0.0 && is_finite(norm) && (float)e.z >= (float)NEAR)) return false;
    e.inverse_norm = 1.0 / sqrt(norm);
    for (int i = 0; i < 4; ++i) e.quat[i] = quat[i] * e.inverse_norm;
    const double w = e.quat[0], x = e.quat[1], y = e.quat[2], z = e.quat[3];
    const double turn[3][3] = {
        {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
        {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
        {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)},
    };
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
            e.turn[i][k] = turn[i][k];
            e.axes[i][k] = turn[i][k] * scale[k];
        }
    }
    const double near = 1.0 / e.z;
    e.u = e.x * near;
    e.v = e.y * near;
    e.bounded_u = bound(e.u, camera.low_u, camera.high_u);
    e.bounded_v = bound(e.v, camera.low_v, camera.high_v);
    if (camera.orthographic != 0.0) {
        e.j00 = camera.fx;
        e.j11 = camera.fy;
        e.j02 = e.j12 = 0.0;
    } else {
        e.j00 = camera.fx * near;
        e.j11 = camera.fy * near;
        e.j02 = -e.j00 * e.bounded_u;
        e.j12 = -e.j11 * e.bounded_v;
    }
    for (int k = 0; k < 3; ++k) {
        e.to_plane[0][k] = e.j00 * r[k] + e.j02 * r[6 + k];
        e.to_plane[1][k] = e.j11 * r[3 + k] + e.j12 * r[6 + k];
    }
    for (int i = 0; i < 2; ++i) {
        for (int k = 0; k < 3; ++k) {
            e.half[i][k] = e.to_plane[i][0] * e.axes[0][k] + e.to_plane[i][1] * e.axes[1][k] + e.to_plane[i][2] * e.axes[2][k];
        }
    }
    const double *p = e.half[0], *q = e.half[1];
    e.a = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
    e.b = p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
    e.c = q[0] * q[0] + q[1] * q[1] + q[2] * q[2];
    const double k0 = p[1] * q[2] - p[2] * q[1], k1 = p[2] * q[0] - p[0] * q[2], k2 = p[0] * q[1] - p[1] * q[0];
    e.det = k0 * k0 + k1 * k1 + k2 * k2;  // free of cancellation, unlike a c - b^2
    e.det_dilated = e.det + DILATION * (e.a + e.c) + DILATION * DILATION;
    return true;
}

// One thread a Gaussian: its record, and how many tiles it may touch (0: it is not drawn).
extern "C" __global__ void project(
    int count, const float *means, const float *quats, const float *scales, const float *opacities, const float *colors,
    const float *features, const Camera camera, Record *records, int *touched) {
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= count) return;
    touched[i] = 0;
    const float opacity = opacities[i];
    Expansion e;
    if (!(opacity > (float)ALPHA_MIN && is_finite(opacity))) return;
    if (!expand(means + 3 * (int64)i, quats + 4 * (int64)i, scales + 3 * (int64)i, camera, e)) return;
    float total = (colors[3 * (int64)i] + colors[3 * (int64)i + 1] + colors[3 * (int64)i + 2]) * 0.0f;
    for (int k = 0; k < FEATURES; ++k) total += features[(int64)FEATURES * i + k] * 0.0f;
    if (total != 0.0f) return;  // also where it is not a number

    const double a = e.a + DILATION, c = e.c + DILATION;
    double cover = opacity < 1.0f ? (double)opacity : 1.0;
    if (camera.antialiased != 0.0) {
        const double ratio = e.det / e.det_dilated;
        cover *= sqrt(ratio > COMPENSATION_MIN ? ratio : COMPENSATION_MIN);
    }
    if (!(cover > ALPHA_MIN)) return;
    const bool parallel = camera.orthographic != 0.0;
    const double x = camera.fx * (parallel ? e.x : e.u) + camera.cx, y = camera.fy * (parallel ? e.y : e.v) + camera.cy;
    const double reach = 2.0 * log(cover / ALPHA_MIN);
    const double half_x = sqrt(reach * a), half_y = sqrt(reach * c);
    // The comparisons are also false for numbers that are not finite.
    if (!(x + half_x > 0.0 && x - half_x < camera.width && y + half_y > 0.0 && y - half_y < camera.height)) return;
    if (!(fabs(x) < FAR_AWAY && fabs(y) < FAR_AWAY && half_x < FAR_AWAY && half_y < FAR_AWAY)) return;

    const int x0 = (int)bound(x - half_x, 0.0, camera.width - 1.0) / TILE;
    const int y0 = (int)bound(y - half_y, 0.0, camera.height - 1.0) / TILE;
    const int x1 = (int)bound(x + half_x, 0.0, camera.width - 1.0) / TILE + 1;
    const int y1 = (int)bound(y + half_y, 0.0, camera.height - 1.0) / TILE + 1;
    Record record;
    record.x = (float)x;
    record.y = (float)y;
    record.l11 = (float)sqrt(c / e.det_dilated);
    record.l12 = (float)(-e.b / sqrt(c * e.det_dilated));
    record.l22 = (float)(1.0 / sqrt(c));
    record.opacity = (float)cover;
    record.red = colors[3 * (int64)i];
    record.green = colors[3 * (int64)i + 1];
    record.blue = colors[3 * (int64)i + 2];
    record.depth = (float)e.z;
    record.first = (unsigned)x0 | (unsigned)y0 << 16;
    record.end = (unsigned)x1 | (unsigned)y1 << 16;
    records[i] = record;
    touched[i] = (x1 - x0) * (y1 - y0);
}

// One thread a Gaussian: lists it in its tiles, with tile << 32 | depth to sort by. `ends` is the running sum of `touched`.
extern "C" __global__ void list_tiles(
    int count, int tiles_x, const Record *records, const int *touched, const int64 *ends, int64 *keys, int *owners) {
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= count || touched[i] == 0) return;
    const Record record = records[i];
    union {
        float number;
        unsigned bits;
    } depth;
    depth.number = record.depth;  // positive, so that its bits sort like the number
    int64 slot = ends[i] - touched[i];
    for (unsigned y = record.first >> 16; y < record.end >> 16; ++y) {
        for (unsigned x = record.first & 0xffff; x < (record.end & 0xffff); ++x) {
            keys[slot] = (int64)(y * (unsigned)tiles_x + x) << 32 | (int64)depth.bits;
            owners[slot] = i;
            ++slot;
        }
    }
}

// Alpha of a Gaussian at a pixel centre, and its whitened offset s, q.
__device__ inline float cover_at(const Record &record, float x, float y, float &s, float &q) {
    const float dx = x - record.x, dy = y - record.y;
    s = record.l11 * dx + record.l12 * dy;
    q = record.l22 * dy;
    return record.opacity * expf(-0.5f * (s * s + q * q));
}

// A thread's pixel: one block a tile, one thread a pixel.
struct Pixel {
    int tile;
    bool inside;  // of the picture
    int64 index;  // in the picture
    float x, y;   // centre
};

__device__ inline Pixel own_pixel(int tiles_x, int width, int height) {
    const int column = blockIdx.x * TILE + threadIdx.x % TILE, row = blockIdx.y * TILE + threadIdx.x / TILE;
    return {(int)(blockIdx.y * tiles_x + blockIdx.x), column < width && row < height, (int64)row * width + column,
            column + 0.5f, row + 0.5f};
}

// Fetches up to THREADS instances into shared memory, one a thread; returns how many: 0 at the end, and when no thread's pixel is open.
__device__ inline int fetch(
    bool open, int64 batch, int64 end, const int *gaussian, const Record *records, Record *shared_records, int *shared_owners) {
    if (batch >= end || __syncthreads_count(open) == 0) return 0;
    const int64 mine = batch + threadIdx.x;
    if (mine < end) {
        shared_owners[threadIdx.x] = gaussian[mine];
        shared_records[threadIdx.x] = records[gaussian[mine]];
    }
    __syncthreads();
    return end - batch < THREADS ? (int)(end - batch) : THREADS;
}

// Blends a tile. `starts`: first instance of each tile, sorted by depth.
// `background_step`: 3 for a picture [H, W, 3], 0 for one color.
extern "C" __global__ void __launch_bounds__(THREADS) blend(
    int tiles_x, int width, int height, const int64 *starts, const int *gaussian, const Record *records, const float *features,
    const float *background, int background_step, float *rgb, float *alpha, float *depth, float *blended) {
    __shared__ Record shared_records[THREADS];
    __shared__ int shared_owners[THREADS];
    const Pixel own = own_pixel(tiles_x, width, height);
    float sums[CHANNELS];
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) sums[c] = 0.0f;
    float through = 1.0f;
    bool open = own.inside;
    const int64 first = starts[own.tile], end = starts[own.tile + 1];
    int here;
    for (int64 batch = first; (here = fetch(open, batch, end, gaussian, records, shared_records, shared_owners)) > 0; batch += here) {
        for (int k = 0; open && k < here; ++k) {
            float s, q;
            const Record &record = shared_records[k];
            const float cover = cover_at(record, own.x, own.y, s, q);
            if (cover < (float)ALPHA_MIN) continue;
            const float after = through * (1.0f - cover);
            open = after >= (float)TRANSMITTANCE_MIN;
            const float weight = open ? cover * through : through;  // the last one covers all that is left
            sums[0] += weight * record.red;
            sums[1] += weight * record.green;
            sums[2] += weight * record.blue;
            sums[3] += weight * record.depth;
            const float *values = features + (int64)FEATURES * shared_owners[k];
#pragma unroll
            for (int c = 0; c < FEATURES; ++c) sums[BASE + c] += weight * values[c];
            through = open ? after : 0.0f;
        }
    }
    if (!own.inside) return;
    const int64 pixel = own.index;
    const float covered = 1.0f - through;
    for (int c = 0; c < 3; ++c) rgb[3 * pixel + c] = sums[c] + through * background[background_step * pixel + c];
    alpha[pixel] = covered;
    depth[pixel] = covered > 0.0f ? sums[3] / covered : 0.0f;
    for (int c = 0; c < FEATURES; ++c) blended[FEATURES * pixel + c] = sums[BASE + c];
}

// A step of `warp_totals`: every lane hands over the half of its 2 * width values that it does not keep.
template <int width>
__device__ inline void exchange(float *values, int lane) {
    const bool upper = lane & width;
#pragma unroll
    for (int i = 0; i < width; ++i) {
        const float give = upper ? values[i] : values[i + width], keep = upper ? values[i + width] : values[i];
        values[i] = keep + __shfl_xor_sync(ALL_LANES, give, width);
    }
}

// Sums parts[0 .. PARTS) over the 32 lanes of a warp; lane l writes the sums l, l + 32, ... to `to`.
__device__ inline void warp_totals(float *parts, int lane, float *to) {
#pragma unroll
    for (int start = 0; start < PARTS; start += 32) {
        float *values = parts + start;
        exchange<16>(values, lane);
        exchange<8>(values, lane);
        exchange<4>(values, lane);
        exchange<2>(values, lane);
        exchange<1>(values, lane);
        to[start + lane] = values[0];
    }
}

// Gradients of blending: replays a tile from front to back and writes what each instance receives to a row of its own, so that
// no two threads add to one number and the result is the same every time. `order`: each sorted instance's slot, its row.
// A row holds the sums of g, g s, g q, g s^2, g s q, g q^2 with g = alpha dL/dalpha, then the gradients of the channels.
extern "C" __global__ void __launch_bounds__(THREADS) replay(
    int tiles_x, int width, int height, const int64 *starts, const int *gaussian, const int64 *order, const Record *records,
    const float *features, const float *rgb, const float *alpha, const float *depth, const float *blended, const float *d_rgb,
    const float *d_alpha, const float *d_depth, const float *d_blended, float *rows) {
    __shared__ Record shared_records[THREADS];
    __shared__ int shared_owners[THREADS];
    __shared__ float partial[TOGETHER][THREADS / 32][PARTS];
    const Pixel own = own_pixel(tiles_x, width, height);
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32;
    float pull[CHANNELS];  // gradient of the sums of the channels
    float behind = 0.0f;   // gradient times the light that arrives from behind
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) pull[c] = 0.0f;
    if (own.inside) {
        const int64 pixel = own.index;
        const float covered = alpha[pixel];
        behind = -(1.0f - covered) * d_alpha[pixel];
        for (int c = 0; c < 3; ++c) {
            pull[c] = d_rgb[3 * pixel + c];
            behind += pull[c] * rgb[3 * pixel + c];
        }
        pull[3] = covered > 0.0f ? d_depth[pixel] / covered : 0.0f;
        behind += pull[3] * depth[pixel];
#pragma unroll
        for (int c = 0; c < FEATURES; ++c) {
            pull[BASE + c] = d_blended[FEATURES * pixel + c];
            behind += pull[BASE + c] * blended[FEATURES * pixel + c];
        }
    }
    float through = 1.0f;
    bool open = own.inside;
    const int64 first = starts[own.tile], end = starts[own.tile + 1];
    int here;
    for (int64 batch = first; (here = fetch(open, batch, end, gaussian, records, shared_records, shared_owners)) > 0; batch += here) {
        for (int group = 0; group < here; group += TOGETHER) {
            const int members = here - group < TOGETHER ? here - group : TOGETHER;
            for (int member = 0; member < members; ++member) {
                const Record &record = shared_records[group + member];
                float s, q;
                const float cover = cover_at(record, own.x, own.y, s, q);
                const bool blends = open && cover >= (float)ALPHA_MIN;
                const float after = through * (1.0f - cover);
                const bool last = blends && after < (float)TRANSMITTANCE_MIN;  // covers all that is left, whatever its cover is
                if (last) open = false;
                float *to = partial[member][warp];
                if (!__any_sync(ALL_LANES, blends)) {
                    for (int k = lane; k < PARTS; k += 32) to[k] = 0.0f;
                    continue;
                }
                float parts[PARTS];
#pragma unroll
                for (int k = 0; k < PARTS; ++k) parts[k] = 0.0f;
                if (blends) {
                    const float weight = last ? through : cover * through;
                    const float *values = features + (int64)FEATURES * shared_owners[group + member];
                    float dot = pull[0] * record.red + pull[1] * record.green + pull[2] * record.blue + pull[3] * record.depth;
#pragma unroll
                    for (int c = 0; c < FEATURES; ++c) dot += pull[BASE + c] * values[c];
#pragma unroll
                    for (int c = 0; c < CHANNELS; ++c) parts[MOMENTS + c] = weight * pull[c];
                    behind -= weight * dot;
                    if (!last) {
                        const float g = cover * (through * dot - behind / (1.0f - cover));
                        parts[0] = g;
                        parts[1] = g * s;
                        parts[2] = g * q;
                        parts[3] = g * s * s;
                        parts[4] = g * s * q;
                        parts[5] = g * q * q;
                    }
                    through = after;
                }
                warp_totals(parts, lane, to);
            }
            __syncthreads();
            for (int k = threadIdx.x; k < members * ROW; k += THREADS) {
                const int member = k / ROW, c = k % ROW;
                float total = 0.0f;
                for (int w = 0; w < THREADS / 32; ++w) total += partial[member][w][c];
                rows[order[batch + group + member] * ROW + c] = total;
            }
            __syncthreads();
        }
    }
}

// One thread a Gaussian: sums its rows and carries the sums back through the projection. The outputs are zero on entry.
extern "C" __global__ void collect(
    int count, const float *means, const float *quats, const float *scales, const float *opacities, const Camera camera,
    const Record *records, const int *touched, const int64 *ends, const float *rows, float *d_means, float *d_quats,
    float *d_scales, float *d_opacities, float *d_colors, float *d_features) {
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= count || touched[i] == 0) return;
    float sums[ROW];
    for (int c = 0; c < ROW; ++c) sums[c] = 0.0f;
    for (int64 slot = ends[i] - touched[i]; slot < ends[i]; ++slot) {
        for (int c = 0; c < ROW; ++c) sums[c] += rows[slot * ROW + c];
    }
    for (int c = 0; c < 3; ++c) d_colors[3 * (int64)i + c] = sums[MOMENTS + c];
    for (int c = 0; c < FEATURES; ++c) d_features[FEATURES * (int64)i + c] = sums[MOMENTS + BASE + c];

    Expansion e;
    expand(means + 3 * (int64)i, quats + 4 * (int64)i, scales + 3 * (int64)i, camera, e);
    const Record record = records[i];
    const double l11 = record.l11, l12 = record.l12, l22 = record.l22;
    const double gss = sums[3], gsq = sums[4], gqq = sums[5];
    const double d_x = l11 * sums[1], d_y = l12 * sums[1] + l22 * sums[2];
    double d_a = 0.5 * l11 * l11 * gss;
    double d_b = l11 * (l12 * gss + l22 * gsq);  // b stands twice in the matrix
    double d_c = 0.5 * (l12 * l12 * gss + 2.0 * l12 * l22 * gsq + l22 * l22 * gqq);
    const double d_peak = sums[0] / (double)record.opacity;  // of the opacity after cap and compensation
    double d_opacity = opacities[i] <= 1.0f ? d_peak : 0.0;
    if (camera.antialiased != 0.0) {
        const double ratio = e.det / e.det_dilated;
        const double compensation = sqrt(ratio > COMPENSATION_MIN ? ratio : COMPENSATION_MIN);
        const double d_compensation = d_peak * (opacities[i] < 1.0f ? (double)opacities[i] : 1.0);
        d_opacity *= compensation;
        if (ratio > COMPENSATION_MIN) {
            const double d_ratio = 0.5 * d_compensation / compensation;
            const double d_det = d_ratio / e.det_dilated, d_dilated = -d_ratio * e.det / (e.det_dilated * e.det_dilated);
            d_a += d_det * e.c + d_dilated * (e.c + DILATION);
            d_c += d_det * e.a + d_dilated * (e.a + DILATION);
            d_b -= 2.0 * e.b * (d_det + d_dilated);
        }
    }
    d_opacities[i] = (float)d_opacity;

    // a = half0 half0, b = half0 half1, c = half1 half1; half = to_plane axes; axes = turn scales.
    double d_half[2][3], d_turn[3][3];
    for (int k = 0; k < 3; ++k) {
        d_half[0][k] = 2 * d_a * e.half[0][k] + d_b * e.half[1][k];
        d_half[1][k] = 2 * d_c * e.half[1][k] + d_b * e.half[0][k];
    }
    for (int k = 0; k < 3; ++k) {
        double d_scale = 0.0;
        for (int j = 0; j < 3; ++j) {
            const double d_axis = e.to_plane[0][j] * d_half[0][k] + e.to_plane[1][j] * d_half[1][k];
            d_scale += d_axis * e.turn[j][k];
            d_turn[j][k] = d_axis * scales[3 * (int64)i + k];
        }
        d_scales[3 * (int64)i + k] = (float)d_scale;
    }
    const double w = e.quat[0], x = e.quat[1], y = e.quat[2], z = e.quat[3];
    const double d_quat[4] = {
        2 * (x * (d_turn[2][1] - d_turn[1][2]) + y * (d_turn[0][2] - d_turn[2][0]) + z * (d_turn[1][0] - d_turn[0][1])),
        2 * (y * (d_turn[0][1] + d_turn[1][0]) + z * (d_turn[0][2] + d_turn[2][0]) + w * (d_turn[2][1] - d_turn[1][2]))
            - 4 * x * (d_turn[1][1] + d_turn[2][2]),
        2 * (x * (d_turn[0][1] + d_turn[1][0]) + z * (d_turn[1][2] + d_turn[2][1]) + w * (d_turn[0][2] - d_turn[2][0]))
            - 4 * y * (d_turn[0][0] + d_turn[2][2]),
        2 * (x * (d_turn[0][2] + d_turn[2][0]) + y * (d_turn[1][2] + d_turn[2][1]) + w * (d_turn[1][0] - d_turn[0][1]))
            - 4 * z * (d_turn[0][0] + d_turn[1][1]),
    };
    const double along = d_quat[0] * w + d_quat[1] * x + d_quat[2] * y + d_quat[3] * z;
    for (int k = 0; k < 4; ++k) d_quats[4 * (int64)i + k] = (float)((d_quat[k] - along * e.quat[k]) * e.inverse_norm);

    double d_camera[3] = {d_x * camera.fx, d_y * camera.fy, (double)sums[MOMENTS + 3]};
    const double *r = camera.rotation;
    if (camera.orthographic == 0.0) {
        double d_j00 = 0.0, d_j02 = 0.0, d_j11 = 0.0, d_j12 = 0.0;
        for (int j = 0; j < 3; ++j) {
            double first = 0.0, second = 0.0;  // gradients of to_plane
            for (int k = 0; k < 3; ++k) {
                first += d_half[0][k] * e.axes[j][k];
                second += d_half[1][k] * e.axes[j][k];
            }
            d_j00 += first * r[j];
            d_j02 += first * r[6 + j];
            d_j11 += second * r[3 + j];
            d_j12 += second * r[6 + j];
        }
        const double near = 1.0 / e.z;
        double d_u = d_x * camera.fx, d_v = d_y * camera.fy;
        if (e.bounded_u == e.u) d_u -= d_j02 * e.j00;
        if (e.bounded_v == e.v) d_v -= d_j12 * e.j11;
        const double d_near = camera.fx * (d_j00 - d_j02 * e.bounded_u) + camera.fy * (d_j11 - d_j12 * e.bounded_v)
                              + d_u * e.x + d_v * e.y;
        d_camera[0] = d_u * near;
        d_camera[1] = d_v * near;
        d_camera[2] -= d_near * near * near;
    }
    for (int k = 0; k < 3; ++k) {
        d_means[3 * (int64)i + k] = (float)(r[k] * d_camera[0] + r[3 + k] * d_camera[1] + r[6 + k] * d_camera[2]);
    }
}
