// Ray queries in batches; see trace_shim.h.
//
// No exceptions cross this file: Embree reports errors through the device's callback and nothing here allocates.

#include "trace_shim.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace {

// Flush-to-zero and denormals-are-zero while Embree traverses (its documentation asks for both); the caller's mode
// returns on scope exit, because Rust code may not run with another floating-point environment.
class DenormalsOff {
#if defined(__SSE2__)
    unsigned int saved_;

  public:
    DenormalsOff() : saved_(_mm_getcsr()) { _mm_setcsr(saved_ | 0x8040u); }
    ~DenormalsOff() { _mm_setcsr(saved_); }
#else
  public:
    DenormalsOff() {}
    ~DenormalsOff() {}
#endif
    DenormalsOff(const DenormalsOff &) = delete;
    DenormalsOff &operator=(const DenormalsOff &) = delete;
};

// Triple products of coordinates beyond this would overflow inside the intersection test (1e12 cubed is 1e36).
constexpr float FAR_AWAY = 1e12f;
// Directions are unit vectors; a squared length below this is no direction (and would be a denormal soon).
constexpr float TINY = 1e-30f;

// Comparisons are written so that NaN fails them, and joined without branches.
inline bool usable(const UnbakeRay &r) {
    const float d2 = r.direction[0] * r.direction[0] + r.direction[1] * r.direction[1] + r.direction[2] * r.direction[2];
    return (std::fabs(r.origin[0]) < FAR_AWAY) & (std::fabs(r.origin[1]) < FAR_AWAY) & (std::fabs(r.origin[2]) < FAR_AWAY) &
           (d2 > TINY) & (d2 < FAR_AWAY) & (r.t_near < FAR_AWAY) & (r.t_far >= r.t_near) & (r.t_far > 0.0f);
}

inline float near_of(const UnbakeRay &r) { return r.t_near > 0.0f ? r.t_near : 0.0f; }

inline void load(const UnbakeRay &r, RTCRay &out) {
    out.org_x = r.origin[0];
    out.org_y = r.origin[1];
    out.org_z = r.origin[2];
    out.tnear = near_of(r);
    out.dir_x = r.direction[0];
    out.dir_y = r.direction[1];
    out.dir_z = r.direction[2];
    out.time = 0.0f;
    out.tfar = r.t_far;
    out.mask = 0xffffffffu;
    out.id = 0;
    out.flags = 0;
}

// Four lanes at a time, in the compiler's own vectors: the same source on every processor.
typedef float Floats __attribute__((vector_size(16)));
typedef int32_t Flags __attribute__((vector_size(16)));
constexpr int LANES = 4;

inline Floats floats(float x) { return Floats{x, x, x, x}; }
inline Floats size_of(Floats x) { return reinterpret_cast<Floats>(reinterpret_cast<Flags>(x) & 0x7fffffff); }
inline Floats choose(Flags which, Floats a, Floats b) {
    return reinterpret_cast<Floats>((reinterpret_cast<Flags>(a) & which) | (reinterpret_cast<Flags>(b) & ~which));
}
template <typename Vector, typename Number> inline Vector vector_at(const Number *from) {
    Vector v;
    std::memcpy(&v, from, sizeof v);
    return v;
}
template <typename Vector, typename Number> inline void store(Number *to, Vector v) { std::memcpy(to, &v, sizeof v); }

// Rows become columns.
inline void transpose(Floats (&m)[LANES]) {
    const Floats a = __builtin_shufflevector(m[0], m[1], 0, 4, 1, 5), b = __builtin_shufflevector(m[2], m[3], 0, 4, 1, 5);
    const Floats c = __builtin_shufflevector(m[0], m[1], 2, 6, 3, 7), d = __builtin_shufflevector(m[2], m[3], 2, 6, 3, 7);
    m[0] = __builtin_shufflevector(a, b, 0, 1, 4, 5);
    m[1] = __builtin_shufflevector(a, b, 2, 3, 6, 7);
    m[2] = __builtin_shufflevector(c, d, 0, 1, 4, 5);
    m[3] = __builtin_shufflevector(c, d, 2, 3, 6, 7);
}

// Writes four rays to the lanes from k on. Those that are not usable are marked invalid and become harmless ones: where packets are
// split further, Embree looks at idle lanes' numbers too (Debian builds Embree with assertions, which would end the program).
template <typename Packet> inline void load(const UnbakeRay *rays, Packet &p, int *valid, int k) {
    Floats o[LANES], d[LANES];
    for (int l = 0; l < LANES; ++l) {
        o[l] = vector_at<Floats>(rays[l].origin);
        d[l] = vector_at<Floats>(rays[l].direction);
    }
    transpose(o);
    transpose(d);
    // as `usable`
    const Floats far_away = floats(FAR_AWAY), d2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    const Flags good = (size_of(o[0]) < far_away) & (size_of(o[1]) < far_away) & (size_of(o[2]) < far_away) &
                       (d2 > floats(TINY)) & (d2 < far_away) & (o[3] < far_away) & (d[3] >= o[3]) & (d[3] > floats(0.0f));
    o[3] = choose(o[3] > floats(0.0f), o[3], floats(0.0f));
    const Floats zero = floats(0.0f);
    store(valid + k, good);
    store(p.org_x + k, choose(good, o[0], zero));
    store(p.org_y + k, choose(good, o[1], zero));
    store(p.org_z + k, choose(good, o[2], zero));
    store(p.tnear + k, choose(good, o[3], zero));
    store(p.dir_x + k, choose(good, d[0], zero));
    store(p.dir_y + k, choose(good, d[1], zero));
    store(p.dir_z + k, choose(good, d[2], floats(1.0f)));
    store(p.tfar + k, choose(good, d[3], zero));
}

// A packet of W rays from `count`, which may be fewer.
template <int W, typename Packet> inline void load_packet(const UnbakeRay *rays, size_t count, Packet &p, int *valid) {
    UnbakeRay padded[W];
    if (count < W) {
        std::copy(rays, rays + count, padded);
        // (not usable: of no length)
        std::fill(padded + count, padded + W, UnbakeRay{{0.0f, 0.0f, 0.0f}, 0.0f, {0.0f, 0.0f, 1.0f}, 0.0f});
        rays = padded;
    }
    for (int k = 0; k < W; k += LANES) {
        load(rays + k, p, valid, k);
    }
}

void occluded_one_by_one(RTCScene scene, const UnbakeRay *rays, uint8_t *out, size_t n) {
    unbake::OccludedArguments arguments;
    for (size_t i = 0; i < n; ++i) {
        uint8_t blocked = 0;
        if (usable(rays[i])) {
            RTCRay ray;
            load(rays[i], ray);
            unbake::occluded1(scene, &ray, arguments);
            blocked = ray.tfar < 0.0f;
        }
        out[i] = blocked;
    }
}

inline void occluded_packet(const int *valid, RTCScene scene, RTCRay8 *p, unbake::OccludedArguments &a) {
    unbake::occluded8(valid, scene, p, a);
}
inline void occluded_packet(const int *valid, RTCScene scene, RTCRay16 *p, unbake::OccludedArguments &a) {
    unbake::occluded16(valid, scene, p, a);
}

template <typename Packet, int W>
void occluded_in_packets(RTCScene scene, const UnbakeRay *rays, uint8_t *out, size_t n) {
    unbake::OccludedArguments arguments;
    alignas(64) int valid[W];
    alignas(64) Packet p;
    for (int k = 0; k < W; ++k) {
        p.time[k] = 0.0f;
        p.mask[k] = 0xffffffffu;
        p.id[k] = 0;
        p.flags[k] = 0;
    }
    for (size_t base = 0; base < n; base += W) {
        const size_t count = std::min<size_t>(n - base, W);
        load_packet<W>(rays + base, count, p, valid);
        occluded_packet(valid, scene, &p, arguments);
        for (size_t k = 0; k < count; ++k) {
            out[base + k] = (valid[k] != 0) & (p.tfar[k] < 0.0f);
        }
    }
}

}  // namespace

extern "C" void unbake_closest(RTCScene scene, const UnbakeRay *rays, UnbakeHit *hits, size_t n) {
    constexpr int W = 8;
    const DenormalsOff mode;
    unbake::ClosestArguments arguments;
    alignas(64) int valid[W];
    alignas(64) RTCRayHit8 p;
    for (int k = 0; k < W; ++k) {
        p.ray.time[k] = 0.0f;
        p.ray.mask[k] = 0xffffffffu;
        p.ray.id[k] = 0;
        p.ray.flags[k] = 0;
    }
    for (size_t base = 0; base < n; base += W) {
        const size_t count = std::min<size_t>(n - base, W);
        load_packet<W>(rays + base, count, p.ray, valid);
        for (int k = 0; k < W; ++k) {
            p.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
            p.hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
        }
        unbake::intersect8(valid, scene, &p, arguments);
        UnbakeHit packet[W];
        for (int k = 0; k < W; k += LANES) {
            const Floats t = vector_at<Floats>(p.ray.tfar + k), infinity = floats(std::numeric_limits<float>::infinity());
            const Flags none = Flags{-1, -1, -1, -1};
            // The quotient of a sliver can overflow where t_far is infinite: that is no place.
            const Flags found = vector_at<Flags>(valid + k) & (vector_at<Flags>(p.hit.geomID + k) != none) & (t < infinity);
            Floats rows[LANES] = {choose(found, t, infinity), choose(found, vector_at<Floats>(p.hit.u + k), floats(0.0f)),
                                  choose(found, vector_at<Floats>(p.hit.v + k), floats(0.0f)),
                                  choose(found, vector_at<Floats>(p.hit.primID + k), reinterpret_cast<Floats>(none))};
            transpose(rows);
            for (int l = 0; l < LANES; ++l) {
                store(packet + k + l, rows[l]);
            }
        }
        std::copy(packet, packet + count, hits + base);
    }
}

extern "C" void unbake_occluded(RTCScene scene, const UnbakeRay *rays, uint8_t *out, size_t n, int width) {
    const DenormalsOff mode;
    if (width == 16) {
        occluded_in_packets<RTCRay16, 16>(scene, rays, out, n);
    } else if (width == 8) {
        occluded_in_packets<RTCRay8, 8>(scene, rays, out, n);
    } else {
        occluded_one_by_one(scene, rays, out, n);
    }
}

extern "C" size_t unbake_bare_closest(RTCScene scene, const UnbakeRay *rays, size_t n) {
    const DenormalsOff mode;
    unbake::ClosestArguments arguments;
    size_t found = 0;
    alignas(16) RTCRayHit rh;
    for (size_t i = 0; i < n; ++i) {
        load(rays[i], rh.ray);
        rh.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        rh.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
        unbake::intersect1(scene, &rh, arguments);
        found += rh.hit.geomID != RTC_INVALID_GEOMETRY_ID;
    }
    return found;
}

extern "C" size_t unbake_bare_occluded(RTCScene scene, const UnbakeRay *rays, size_t n) {
    const DenormalsOff mode;
    unbake::OccludedArguments arguments;
    size_t found = 0;
    for (size_t i = 0; i < n; ++i) {
        alignas(16) RTCRay ray;
        load(rays[i], ray);
        unbake::occluded1(scene, &ray, arguments);
        found += ray.tfar < 0.0f;
    }
    return found;
}
