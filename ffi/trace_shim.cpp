// Ray queries in batches; see trace_shim.h.
//
// No exceptions cross this file: Embree reports errors through the device's callback and nothing here allocates.

#include "trace_shim.h"

#include <cmath>
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

constexpr UnbakeRay HARMLESS = {{0.0f, 0.0f, 0.0f}, 0.0f, {0.0f, 0.0f, 1.0f}, 0.0f};

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

// Ray number k of a packet.
template <typename Packet> inline void load(const UnbakeRay &r, Packet &p, int k) {
    p.org_x[k] = r.origin[0];
    p.org_y[k] = r.origin[1];
    p.org_z[k] = r.origin[2];
    p.tnear[k] = near_of(r);
    p.dir_x[k] = r.direction[0];
    p.dir_y[k] = r.direction[1];
    p.dir_z[k] = r.direction[2];
    p.tfar[k] = r.t_far;
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
        const int count = static_cast<int>(n - base < static_cast<size_t>(W) ? n - base : W);
        for (int k = 0; k < W; ++k) {
            // Idle lanes carry a harmless ray: where packets are split further, Embree looks at their numbers too
            // (Debian builds Embree with assertions, which would end the program).
            valid[k] = (k < count && usable(rays[base + k])) ? -1 : 0;
            load(valid[k] ? rays[base + k] : HARMLESS, p, k);
        }
        occluded_packet(valid, scene, &p, arguments);
        for (int k = 0; k < count; ++k) {
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
        const int count = static_cast<int>(n - base < static_cast<size_t>(W) ? n - base : W);
        for (int k = 0; k < W; ++k) {
            valid[k] = (k < count && usable(rays[base + k])) ? -1 : 0;
            load(valid[k] ? rays[base + k] : HARMLESS, p.ray, k);
            p.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
            p.hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
        }
        unbake::intersect8(valid, scene, &p, arguments);
        for (int k = 0; k < count; ++k) {
            // The quotient of a sliver can overflow where t_far is infinite: that is no place.
            const bool found = (valid[k] != 0) & (p.hit.geomID[k] != RTC_INVALID_GEOMETRY_ID) &
                               (p.ray.tfar[k] < std::numeric_limits<float>::infinity());
            UnbakeHit &hit = hits[base + k];
            hit.t = found ? p.ray.tfar[k] : std::numeric_limits<float>::infinity();
            hit.u = found ? p.hit.u[k] : 0.0f;
            hit.v = found ? p.hit.v[k] : 0.0f;
            hit.triangle = found ? p.hit.primID[k] : UINT32_MAX;
        }
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
