// OpenImageIO behind a C interface; see oiio_shim.h. Builds from one source on 2.4 and 2.5.

#include "oiio_shim.h"

#include <Imath/ImathVec.h>
#include <OpenImageIO/imageio.h>

#include <cstring>
#include <exception>
#include <memory>
#include <string>
#include <vector>

namespace {

void report(char *error, size_t size, const std::string &text) {
    if (error == nullptr || size == 0) {
        return;
    }
    const size_t n = text.size() < size - 1 ? text.size() : size - 1;
    std::memcpy(error, text.data(), n);
    error[n] = '\0';
}

// Runs `body`, turning any exception into an error text and the value of `failed`.
template <typename T, typename Body>
T guarded(char *error, size_t size, T failed, Body body) {
    try {
        return body();
    } catch (const std::exception &e) {
        report(error, size, e.what());
    } catch (...) {
        report(error, size, "unknown C++ exception");
    }
    return failed;
}

int sample_of(const OIIO::TypeDesc &type) {
    switch (type.basetype) {
        case OIIO::TypeDesc::UINT8: return UNBAKE_SAMPLE_U8;
        case OIIO::TypeDesc::UINT16: return UNBAKE_SAMPLE_U16;
        case OIIO::TypeDesc::HALF: return UNBAKE_SAMPLE_HALF;
        case OIIO::TypeDesc::FLOAT: return UNBAKE_SAMPLE_FLOAT;
        default: return UNBAKE_SAMPLE_OTHER;
    }
}

}  // namespace

extern "C" int unbake_image_abi(void) { return UNBAKE_IMAGE_ABI; }

extern "C" int unbake_image_version(void) { return OIIO::openimageio_version(); }

extern "C" void *unbake_image_open(const char *path, const char *format, int part, UnbakeImageInfo *info, char *error,
                                   size_t size) {
    return guarded<void *>(error, size, nullptr, [&]() -> void * {
        std::unique_ptr<OIIO::ImageInput> input = OIIO::ImageInput::create(format);
        if (!input) {
            report(error, size, "this OpenImageIO has no reader for " + std::string(format) + ": " + OIIO::geterror());
            return nullptr;
        }
        OIIO::ImageSpec spec;
        if (!input->open(path, spec)) {
            report(error, size, input->geterror());
            return nullptr;
        }
        if (part > 0) {
            if (!input->seek_subimage(part, 0)) {
                report(error, size, "it has no part " + std::to_string(part));
                return nullptr;
            }
            spec = input->spec();
        }
        *info = UnbakeImageInfo{spec.width,      spec.height,
                                spec.depth,      spec.nchannels,
                                spec.x,          spec.y,
                                spec.full_x,     spec.full_y,
                                spec.full_width, spec.full_height,
                                sample_of(spec.format), spec.get_int_attribute("Orientation", 1),
                                spec.deep ? 1 : 0};
        return input.release();
    });
}

extern "C" const char *unbake_image_channel(void *image, int channel) {
    const OIIO::ImageSpec &spec = static_cast<OIIO::ImageInput *>(image)->spec();
    if (channel < 0 || channel >= static_cast<int>(spec.channelnames.size())) {
        return "";
    }
    return spec.channelnames[static_cast<size_t>(channel)].c_str();
}

extern "C" int unbake_image_read(void *image, int begin, int end, float *out, size_t stride, char *error,
                                 size_t size) {
    return guarded<int>(error, size, 0, [&]() -> int {
        auto *input = static_cast<OIIO::ImageInput *>(image);
        if (input->read_image(input->current_subimage(), 0, begin, end, OIIO::TypeDesc::FLOAT, out, static_cast<OIIO::stride_t>(stride))) {
            return 1;
        }
        report(error, size, input->geterror());
        return 0;
    });
}

extern "C" void unbake_image_close(void *image) {
    guarded<int>(nullptr, 0, 0, [&]() -> int {
        delete static_cast<OIIO::ImageInput *>(image);
        return 1;
    });
}

extern "C" int unbake_image_write(const char *path, int width, int height, int channels, const char *const *names, int sample,
                                  const void *data, const char *mark, int colour, char *error, size_t size) {
    return guarded<int>(error, size, 0, [&]() -> int {
        std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create("openexr");
        if (!output) {
            report(error, size, "this OpenImageIO cannot write OpenEXR: " + OIIO::geterror());
            return 0;
        }
        const OIIO::TypeDesc type = sample == UNBAKE_SAMPLE_HALF ? OIIO::TypeDesc::HALF : OIIO::TypeDesc::FLOAT;
        OIIO::ImageSpec spec(width, height, channels, type);
        spec.channelnames.assign(names, names + channels);
        spec.attribute("compression", "zip");
        // Otherwise the hour of writing: equal pixels are to be equal files.
        spec.attribute("DateTime", "1970:01:01 00:00:00");
        if (mark[0] != '\0') {
            spec.attribute("unbake:generation", mark);
        }
        if (colour != 0) {
            // ITU-R BT.709: red, green, blue, white
            const float rec709[8] = {0.64f, 0.33f, 0.30f, 0.60f, 0.15f, 0.06f, 0.3127f, 0.3290f};
            spec.attribute("chromaticities", OIIO::TypeDesc(OIIO::TypeDesc::FLOAT, 8), rec709);
        }
        if (!output->open(path, spec) || !output->write_image(type, data) || !output->close()) {
            report(error, size, output->geterror());
            return 0;
        }
        return 1;
    });
}
