// Ray queries in batches: the C side of `unbake::trace`.
//
// A batch call keeps the loop, the denormal mode and the packet layout on this side of the border, so that a million rays
// cost one foreign call per chunk instead of one per ray.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "embree_compat.h"

#ifdef __cplusplus
extern "C" {
#endif

// Same layout as `trace::Ray`: 32 bytes.
typedef struct UnbakeRay {
    float origin[3];
    float t_near;
    float direction[3];
    float t_far;
} UnbakeRay;

// Same layout as `trace::Hit`: 16 bytes; triangle is UINT32_MAX and t infinite for a miss.
typedef struct UnbakeHit {
    float t;
    float u;
    float v;
    uint32_t triangle;
} UnbakeHit;

// Closest hits of n rays. Rays that are not finite, or have no direction, miss.
void unbake_closest(RTCScene scene, const UnbakeRay *rays, UnbakeHit *hits, size_t n);

// out[i] = 1 if anything lies on ray i's segment, else 0. Rays that are not finite, or have no direction, are free.
// `width` is the packet width: 1, 8 or 16.
void unbake_occluded(RTCScene scene, const UnbakeRay *rays, uint8_t *out, size_t n, int width);

// What a C++ programmer would write first: one Embree call per ray and nothing else. The yardstick of the benchmarks; it
// trusts its rays. Both return the number of hits so that nothing can be optimised away.
size_t unbake_bare_closest(RTCScene scene, const UnbakeRay *rays, size_t n);
size_t unbake_bare_occluded(RTCScene scene, const UnbakeRay *rays, size_t n);

#ifdef __cplusplus
}
#endif
