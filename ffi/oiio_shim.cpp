// OpenImageIO behind a C interface; see oiio_shim.h. Builds from one source on 2.4 and 2.5.

#include "oiio_shim.h"

#include <Imath/ImathVec.h>
#include <OpenImageIO/imageio.h>

#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <exception>
#include <memory>
#include <string>
#include <vector>

// after <cstdio>: they use FILE and size_t without including them
#include <jpeglib.h>
#include <jerror.h>

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

// Bytes that writers pad a segment with (to a word or a cache line); more are data that the decoder lost its place in.
constexpr int PADDING = 16;

// libjpeg's manager of errors, which keeps the first remark that means lost data. Plain data: it is left by longjmp.
struct JpegJudge {
    jpeg_error_mgr base;
    jmp_buf out;
    char reason[JMSG_LENGTH_MAX];
    bool ended_early;
};

JpegJudge *judge_of(j_common_ptr codec) { return reinterpret_cast<JpegJudge *>(codec->err); }

void jpeg_failed(j_common_ptr codec) {
    JpegJudge *judge = judge_of(codec);
    judge->base.format_message(codec, judge->reason);
    longjmp(judge->out, 1);
}

void jpeg_remarked(j_common_ptr codec, int level) {
    JpegJudge *judge = judge_of(codec);
    if (level >= 0) {
        return;
    }
    bool lost = false;
    switch (judge->base.msg_code) {
        case JWRN_HIT_MARKER:
        case JWRN_HUFF_BAD_CODE:
        case JWRN_ARITH_BAD_CODE:
        case JWRN_MUST_RESYNC: lost = true; break;
        case JWRN_EXTRANEOUS_DATA: lost = judge->base.msg_parm.i[0] > PADDING; break;
        case JWRN_JPEG_EOF: judge->ended_early = true; break;
        default: break;
    }
    if (lost && judge->reason[0] == '\0') {
        judge->base.format_message(codec, judge->reason);
    }
}

// Decodes all data of an open file at an eighth of its size, which is cheap and looks at every code.
void decode_small(jpeg_decompress_struct *codec, JpegJudge *judge) {
    jpeg_read_header(codec, TRUE);
    codec->out_color_space = codec->jpeg_color_space;
    codec->scale_num = 1;
    codec->scale_denom = 8;
    codec->do_fancy_upsampling = FALSE;
    codec->do_block_smoothing = FALSE;
    const bool several = jpeg_has_multiple_scans(codec) != 0;
    jpeg_start_decompress(codec);
    JSAMPARRAY row = (*codec->mem->alloc_sarray)(reinterpret_cast<j_common_ptr>(codec), JPOOL_IMAGE,
                                                 codec->output_width * static_cast<JDIMENSION>(codec->output_components), 1);
    while (codec->output_scanline < codec->output_height) {
        jpeg_read_scanlines(codec, row, 1);
    }
    jpeg_finish_decompress(codec);
    // one scan without the marker at its end is whole; of several the last may be missing
    if (judge->ended_early && several && judge->reason[0] == '\0') {
        std::strcpy(judge->reason, "Premature end of JPEG file");
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

extern "C" int unbake_image_whole_jpeg(const char *path, char *error, size_t size) {
    FILE *file = std::fopen(path, "rb");
    if (file == nullptr) {
        report(error, size, "cannot be opened");
        return 0;
    }
    jpeg_decompress_struct codec;
    JpegJudge judge;
    std::memset(&judge, 0, sizeof judge);
    codec.err = jpeg_std_error(&judge.base);
    judge.base.error_exit = jpeg_failed;
    judge.base.emit_message = jpeg_remarked;
    jpeg_create_decompress(&codec);
    if (setjmp(judge.out) == 0) {
        jpeg_stdio_src(&codec, file);
        decode_small(&codec, &judge);
    }
    jpeg_destroy_decompress(&codec);
    std::fclose(file);
    if (judge.reason[0] == '\0') {
        return 1;
    }
    report(error, size, judge.reason);
    return 0;
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
