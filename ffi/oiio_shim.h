// OpenImageIO behind a C interface small enough to load by name.
//
// Built into a shared object of its own, which the program carries inside itself and loads at the first image: linking
// OpenImageIO directly would add some 270 shared libraries and a fifth of a second to every start, `--help` included.
// Every function catches C++ exceptions; a failure fills `error` (always terminated) and returns 0 or null.
#pragma once

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define UNBAKE_IMAGE_ABI 3

// Sample types of a file.
enum { UNBAKE_SAMPLE_OTHER = 0, UNBAKE_SAMPLE_U8 = 1, UNBAKE_SAMPLE_U16 = 2, UNBAKE_SAMPLE_HALF = 3, UNBAKE_SAMPLE_FLOAT = 4 };

typedef struct UnbakeImageInfo {
    int32_t width;
    int32_t height;
    int32_t depth;
    int32_t channels;
    // Offset and size of the display window; equal to the data window in an uncropped image.
    int32_t x, y, full_x, full_y, full_width, full_height;
    int32_t sample;
    int32_t orientation;
    int32_t deep;
} UnbakeImageInfo;

// Interface version of this object.
int unbake_image_abi(void);
// OpenImageIO's run-time version as major * 10000 + minor * 100 + patch.
int unbake_image_version(void);

// Opens part `part` (0 is the first) of `path` with the reader called `format` ("openexr", "hdr", "jpeg"), whatever the file's name says.
void *unbake_image_open(const char *path, const char *format, int part, UnbakeImageInfo *info, char *error,
                        size_t error_size);
// Name of a channel; the pointer lives as long as the image is open.
const char *unbake_image_channel(void *image, int channel);
// Reads channels [begin, end) into floats; pixels lie `stride` bytes apart.
int unbake_image_read(void *image, int begin, int end, float *out, size_t stride, char *error, size_t error_size);
void unbake_image_close(void *image);

// Whether a JPEG file holds all of its picture: 1, or 0 with what libjpeg says of it. OpenImageIO keeps libjpeg's warnings to
// itself and hands out the grey that libjpeg fills missing data with.
int unbake_image_whole_jpeg(const char *path, char *error, size_t error_size);

// Writes scanlines as OpenEXR with ZIP compression. `data` holds width * height * channels samples, interleaved, of type
// `sample` (HALF or FLOAT), stored as they are.
// `mark`, if not empty, becomes the text attribute "unbake:generation"; `colour` says that the pixels are linear Rec. 709.
int unbake_image_write(const char *path, int width, int height, int channels, const char *const *names, int sample,
                       const void *data, const char *mark, int colour, char *error, size_t error_size);

#ifdef __cplusplus
}
#endif
