/* Binding of clgs_codec.h: buffers in, bytes or a filled caller's buffer out, GIL released.
 *
 * Arrays are plain contiguous buffers of 4- or 8-byte words in native byte order; the modules
 * clgs.codec.octree, clgs.codec.row_coder and clgs.codec.chunks check shapes and dtypes. Only the
 * limited API.
 */
#include "bindings.h"

typedef enum codec_part { OCTREE, RUNLENGTH, PAPER, PLANES } codec_part;

typedef struct codec_job {
    codec_part part;
    size_t rows, channels, words; /* words per row, for the octree 3 */
    int32_t origin[3];            /* of the octree's encoder */
    Py_buffer data, array;
} codec_job;

static size_t workspace_size(const codec_job *job)
{
    switch (job->part) {
    case OCTREE:
        return clgs_octree_workspace(job->rows);
    case RUNLENGTH:
        return clgs_runlength_workspace(job->channels);
    case PAPER:
        return 0;
    default:
        return clgs_planes_workspace();
    }
}

static size_t output_bound(const codec_job *job)
{
    switch (job->part) {
    case OCTREE:
        return clgs_octree_bound(job->rows);
    case RUNLENGTH:
        return clgs_runlength_bound(job->rows, job->channels);
    case PAPER:
        return clgs_paper_bound(job->rows, job->channels);
    default:
        return clgs_planes_bound(job->rows);
    }
}

static size_t encode(const codec_job *job, uint8_t *out, size_t capacity, void *workspace)
{
    const void *array = job->array.buf;
    switch (job->part) {
    case OCTREE:
        return clgs_octree_encode(array, job->rows, job->origin, out, capacity, workspace);
    case RUNLENGTH:
        return clgs_runlength_encode(array, job->rows, job->channels, out, capacity, workspace);
    case PAPER:
        return clgs_paper_encode(array, job->rows, job->channels, out, capacity);
    default:
        return clgs_planes_encode(array, job->rows, out, capacity, workspace);
    }
}

static clgs_error decode(const codec_job *job, void *workspace)
{
    const uint8_t *data = job->data.buf;
    size_t size = (size_t)job->data.len;
    void *array = job->array.buf;
    switch (job->part) {
    case OCTREE:
        return clgs_octree_decode(data, size, array, job->rows, workspace);
    case RUNLENGTH:
        return clgs_runlength_decode(data, size, array, job->rows, job->channels, workspace);
    case PAPER:
        return clgs_paper_decode(data, size, array, job->rows, job->channels);
    default:
        return clgs_planes_decode(data, size, array, job->rows, workspace);
    }
}

/* Rows of the array, from its size; 0 and an exception if it holds no whole rows. */
static int measure(codec_job *job)
{
    size_t row = 4 * job->words, size = (size_t)job->array.len;
    if (job->channels < 1 || job->channels > CLGS_MAX_CHANNELS || size % row != 0) {
        PyErr_SetString(PyExc_ValueError, "the array does not hold whole rows of 32-bit words");
        return 0;
    }
    job->rows = size / row;
    if (job->rows > CLGS_MAX_POINTS) {
        PyErr_SetString(PyExc_ValueError, "the array has more than 2^27 rows");
        return 0;
    }
    return 1;
}

static PyObject *run_encode(codec_job *job)
{
    PyObject *result = NULL;
    if (!measure(job))
        return NULL;
    size_t bound = output_bound(job), size = 0;
    uint8_t *out = PyMem_Malloc(bound);
    void *workspace = workspace_new(workspace_size(job));
    if (!out || !workspace) {
        PyErr_NoMemory();
    } else {
        Py_BEGIN_ALLOW_THREADS size = encode(job, out, bound, workspace);
        Py_END_ALLOW_THREADS if (size > 0) result =
            PyBytes_FromStringAndSize((const char *)out, (Py_ssize_t)size);
        else PyErr_SetString(PyExc_ValueError, "the array cannot be encoded");
    }
    PyMem_Free(workspace);
    PyMem_Free(out);
    return result;
}

static PyObject *run_decode(codec_job *job)
{
    clgs_error error;
    if (!measure(job))
        return NULL;
    void *workspace = workspace_new(workspace_size(job));
    if (!workspace)
        return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS error = decode(job, workspace);
    Py_END_ALLOW_THREADS PyMem_Free(workspace);
    if (error == CLGS_OK)
        return Py_NewRef(Py_None);
    PyErr_SetString(PyExc_ValueError, clgs_error_text(error));
    return NULL;
}

/* (array[, channels]) -> bytes */
static PyObject *call_encode(codec_part part, PyObject *args)
{
    codec_job job = {.part = part, .channels = 1};
    Py_ssize_t channels = 1;
    if (!PyArg_ParseTuple(args, part == PLANES ? "y*" : "y*n", &job.array, &channels))
        return NULL;
    job.channels = channels < 0 ? 0 : (size_t)channels;
    job.words = job.channels;
    PyObject *result = run_encode(&job);
    PyBuffer_Release(&job.array);
    return result;
}

/* (data, array[, channels]) -> None, the array filled */
static PyObject *call_decode(codec_part part, PyObject *args)
{
    codec_job job = {.part = part, .channels = 1};
    Py_ssize_t channels = 1;
    const char *format = part == RUNLENGTH || part == PAPER ? "y*w*n" : "y*w*";
    if (!PyArg_ParseTuple(args, format, &job.data, &job.array, &channels))
        return NULL;
    job.channels = channels < 0 ? 0 : (size_t)channels;
    job.words = part == OCTREE ? 3 : job.channels;
    PyObject *result = run_decode(&job);
    PyBuffer_Release(&job.array);
    PyBuffer_Release(&job.data);
    return result;
}

/* (position, x, y, z) -> bytes, codes relative to the origin x, y, z */
static PyObject *octree_encode(PyObject *module, PyObject *args)
{
    codec_job job = {.part = OCTREE, .channels = 1, .words = 3};
    int *origin = job.origin;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*iii", &job.array, origin, origin + 1, origin + 2))
        return NULL;
    PyObject *result = run_encode(&job);
    PyBuffer_Release(&job.array);
    return result;
}

static PyObject *octree_decode(PyObject *module, PyObject *args)
{
    (void)module;
    return call_decode(OCTREE, args);
}

static PyObject *runlength_encode(PyObject *module, PyObject *args)
{
    (void)module;
    return call_encode(RUNLENGTH, args);
}

static PyObject *runlength_decode(PyObject *module, PyObject *args)
{
    (void)module;
    return call_decode(RUNLENGTH, args);
}

static PyObject *paper_encode(PyObject *module, PyObject *args)
{
    (void)module;
    return call_encode(PAPER, args);
}

static PyObject *paper_decode(PyObject *module, PyObject *args)
{
    (void)module;
    return call_decode(PAPER, args);
}

static PyObject *planes_encode(PyObject *module, PyObject *args)
{
    (void)module;
    return call_encode(PLANES, args);
}

static PyObject *planes_decode(PyObject *module, PyObject *args)
{
    (void)module;
    return call_decode(PLANES, args);
}

static PyObject *crc32c(PyObject *module, PyObject *args)
{
    Py_buffer data;
    uint32_t crc;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*", &data))
        return NULL;
    Py_BEGIN_ALLOW_THREADS crc = clgs_crc32c(data.buf, (size_t)data.len);
    Py_END_ALLOW_THREADS PyBuffer_Release(&data);
    return PyLong_FromUnsignedLong(crc);
}

static PyObject *xxh64(PyObject *module, PyObject *args)
{
    Py_buffer data;
    uint64_t hash;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*", &data))
        return NULL;
    Py_BEGIN_ALLOW_THREADS hash = clgs_xxh64(data.buf, (size_t)data.len);
    Py_END_ALLOW_THREADS PyBuffer_Release(&data);
    return PyLong_FromUnsignedLongLong(hash);
}

/* (position, code, x, y, z) -> None, the codes filled */
static PyObject *morton_encode(PyObject *module, PyObject *args)
{
    Py_buffer position, code;
    int origin[3];
    (void)module;
    if (!PyArg_ParseTuple(args, "y*w*iii", &position, &code, origin, origin + 1, origin + 2))
        return NULL;
    clgs_error error = CLGS_ERROR_ARGUMENT;
    if (position.len % 12 == 0 && code.len / 8 == position.len / 12) {
        int32_t from[3] = {origin[0], origin[1], origin[2]};
        Py_BEGIN_ALLOW_THREADS error =
            clgs_morton_encode(position.buf, (size_t)position.len / 12, from, code.buf);
        Py_END_ALLOW_THREADS
    }
    PyBuffer_Release(&position);
    PyBuffer_Release(&code);
    if (error == CLGS_OK)
        return Py_NewRef(Py_None);
    PyErr_SetString(PyExc_ValueError, "positions span 2^21 cells or more on an axis");
    return NULL;
}

static PyMethodDef METHODS[] = {
    {"crc32c", crc32c, METH_VARARGS, "crc32c(data) -> int"},
    {"xxh64", xxh64, METH_VARARGS, "xxh64(data) -> int"},
    {"morton_encode", morton_encode, METH_VARARGS, "morton_encode(position, code, x, y, z)"},
    {"octree_encode", octree_encode, METH_VARARGS, "octree_encode(position, x, y, z) -> bytes"},
    {"octree_decode", octree_decode, METH_VARARGS, "octree_decode(data, position)"},
    {"runlength_encode", runlength_encode, METH_VARARGS,
     "runlength_encode(value, channels) -> bytes"},
    {"runlength_decode", runlength_decode, METH_VARARGS, "runlength_decode(data, value, channels)"},
    {"paper_encode", paper_encode, METH_VARARGS, "paper_encode(value, channels) -> bytes"},
    {"paper_decode", paper_decode, METH_VARARGS, "paper_decode(data, value, channels)"},
    {"planes_encode", planes_encode, METH_VARARGS, "planes_encode(word) -> bytes"},
    {"planes_decode", planes_decode, METH_VARARGS, "planes_decode(data, word)"},
    {"attributes_header", attributes_header, METH_VARARGS, "attributes_header(model) -> bytes"},
    {"attributes_read", attributes_read, METH_VARARGS, "attributes_read(data, model)"},
    {"attributes_encode", attributes_encode, METH_VARARGS,
     "attributes_encode(model, value, near) -> bytes"},
    {"attributes_decode", attributes_decode, METH_VARARGS,
     "attributes_decode(model, data, value, near)"},
    {"attributes_count", attributes_count, METH_VARARGS,
     "attributes_count(model, value, count, near)"},
    {"attributes_measure", attributes_measure, METH_VARARGS,
     "attributes_measure(model, value, bytes, near)"},
    {"attributes_choose", attributes_choose, METH_VARARGS,
     "attributes_choose(model, count, scale, cost)"},
    {"attributes_near", attributes_near, METH_VARARGS, "attributes_near(position, near)"},
    {"weights_encode", weights_encode, METH_VARARGS, "weights_encode(word, layers) -> bytes"},
    {"weights_decode", weights_decode, METH_VARARGS, "weights_decode(data, word, layers)"},
    {NULL, NULL, 0, NULL},
};

static PyModuleDef_Slot SLOTS[] = {{0, NULL}};

static struct PyModuleDef MODULE = {
    .m_base = PyModuleDef_HEAD_INIT,
    .m_name = "_codec",
    .m_doc = "The C part of the codec; see codec_c/include/clgs_codec.h.",
    .m_methods = METHODS,
    .m_slots = SLOTS,
};

PyMODINIT_FUNC PyInit__codec(void)
{
    return PyModuleDef_Init(&MODULE);
}
