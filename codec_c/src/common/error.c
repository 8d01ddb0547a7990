#include "clgs_codec.h"

const char *clgs_error_text(clgs_error error)
{
    switch (error) {
    case CLGS_OK:
        return "no error";
    case CLGS_ERROR_ARGUMENT:
        return "a count or buffer size is out of range";
    case CLGS_ERROR_TRUNCATED:
        return "the stream ends before its last symbol";
    case CLGS_ERROR_TRAILING:
        return "bytes follow the last symbol of the stream";
    case CLGS_ERROR_CORRUPT:
        break;
    }
    return "the stream holds what no encoder writes";
}
