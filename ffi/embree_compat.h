// One source for Embree 3.13 and Embree 4.3 or newer.
//
// The code is written to Embree 4's shape: a query takes the scene, the ray and one argument structure. This header
// supplies that shape on 3.13, where the last two are a context passed in the middle. build.rs picks the include folder and
// defines UNBAKE_EMBREE_MAJOR; it refuses Embree 4 before 4.3, whose RTCRayHit is smaller than the one later libraries write.
#pragma once

#if UNBAKE_EMBREE_MAJOR >= 4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#ifdef __cplusplus
#include <cstddef>

namespace unbake {

#if UNBAKE_EMBREE_MAJOR >= 4

// Arguments of closest-hit queries: triangles only, so that Embree may skip every other primitive's code.
struct ClosestArguments {
    RTCIntersectArguments arguments;
    ClosestArguments() {
        rtcInitIntersectArguments(&arguments);
        arguments.feature_mask = RTC_FEATURE_FLAG_TRIANGLE;
    }
};

// Arguments of occlusion queries.
struct OccludedArguments {
    RTCOccludedArguments arguments;
    OccludedArguments() {
        rtcInitOccludedArguments(&arguments);
        arguments.feature_mask = RTC_FEATURE_FLAG_TRIANGLE;
    }
};

inline void intersect1(RTCScene scene, RTCRayHit *ray, ClosestArguments &a) { rtcIntersect1(scene, ray, &a.arguments); }
inline void occluded1(RTCScene scene, RTCRay *ray, OccludedArguments &a) { rtcOccluded1(scene, ray, &a.arguments); }
inline void intersect8(const int *valid, RTCScene scene, RTCRayHit8 *rays, ClosestArguments &a) {
    rtcIntersect8(valid, scene, rays, &a.arguments);
}
inline void occluded8(const int *valid, RTCScene scene, RTCRay8 *rays, OccludedArguments &a) {
    rtcOccluded8(valid, scene, rays, &a.arguments);
}
inline void occluded16(const int *valid, RTCScene scene, RTCRay16 *rays, OccludedArguments &a) {
    rtcOccluded16(valid, scene, rays, &a.arguments);
}

#else

struct ClosestArguments {
    RTCIntersectContext context;
    ClosestArguments() { rtcInitIntersectContext(&context); }
};
using OccludedArguments = ClosestArguments;

inline void intersect1(RTCScene scene, RTCRayHit *ray, ClosestArguments &a) { rtcIntersect1(scene, &a.context, ray); }
inline void occluded1(RTCScene scene, RTCRay *ray, OccludedArguments &a) { rtcOccluded1(scene, &a.context, ray); }
inline void intersect8(const int *valid, RTCScene scene, RTCRayHit8 *rays, ClosestArguments &a) {
    rtcIntersect8(valid, scene, &a.context, rays);
}
inline void occluded8(const int *valid, RTCScene scene, RTCRay8 *rays, OccludedArguments &a) {
    rtcOccluded8(valid, scene, &a.context, rays);
}
inline void occluded16(const int *valid, RTCScene scene, RTCRay16 *rays, OccludedArguments &a) {
    rtcOccluded16(valid, scene, &a.context, rays);
}

#endif

}  // namespace unbake
#endif
