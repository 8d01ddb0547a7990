/* Binding of the attribute coder. A model is a writable buffer of whole channels. */
#include "bindings.h"

#define COUNTS (64 * 256) /* counts of one channel */

static size_t channels_of(const Py_buffer *model)
{
    size_t size = (size_t)model->len, one = clgs_attributes_model_size(1);
    return size % one == 0 && size / one <= CLGS_MAX_CHANNELS ? size / one : 0;
}

/* Channels of the model and rows of the values; 0 and an exception if they do not fit. */
static int measure(const Py_buffer *model, const Py_buffer *value, size_t *channels, size_t *rows)
{
    size_t size = (size_t)value->len;
    *channels = channels_of(model);
    *rows = *channels > 0 ? size / (4 * *channels) : 0;
    if (*rows > 0 && size % (4 * *channels) == 0 && *rows <= CLGS_MAX_POINTS)
        return 1;
    PyErr_SetString(PyExc_ValueError, "the array does not hold whole rows of the model");
    return 0;
}

/* The near rows, or NULL if there are none; 0 and an exception if they do not fit. */
static int near_of(const Py_buffer *near, size_t rows, const int32_t **result)
{
    *result = near->buf;
    if (!near->buf || (size_t)near->len == 4 * CLGS_NEAR * rows)
        return 1;
    PyErr_SetString(PyExc_ValueError, "the near rows are not as many as the rows");
    return 0;
}

static PyObject *result_of(clgs_error error)
{
    if (error == CLGS_OK)
        return Py_NewRef(Py_None);
    PyErr_SetString(PyExc_ValueError, clgs_error_text(error));
    return NULL;
}

static PyObject *bytes_of(const uint8_t *out, size_t size)
{
    if (size > 0)
        return PyBytes_FromStringAndSize((const char *)out, (Py_ssize_t)size);
    PyErr_SetString(PyExc_ValueError, "the array cannot be encoded");
    return NULL;
}

/* (model) -> bytes */
PyObject *attributes_header(PyObject *module, PyObject *args)
{
    Py_buffer model;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(args, "w*", &model))
        return NULL;
    size_t capacity = clgs_attributes_header_bound(channels_of(&model)), size = 0;
    uint8_t *out = PyMem_Malloc(capacity);
    void *workspace = workspace_new(clgs_attributes_header_workspace());
    if (!out || !workspace) {
        PyErr_NoMemory();
    } else {
        Py_BEGIN_ALLOW_THREADS size =
            clgs_attributes_header_write(model.buf, channels_of(&model), out, capacity, workspace);
        Py_END_ALLOW_THREADS result = bytes_of(out, size);
    }
    PyMem_Free(workspace);
    PyMem_Free(out);
    PyBuffer_Release(&model);
    return result;
}

/* (data, model) -> None, the model filled */
PyObject *attributes_read(PyObject *module, PyObject *args)
{
    Py_buffer data, model;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*w*", &data, &model))
        return NULL;
    void *workspace = workspace_new(clgs_attributes_header_workspace());
    if (!workspace) {
        PyErr_NoMemory();
    } else {
        clgs_error error;
        Py_BEGIN_ALLOW_THREADS error = clgs_attributes_header_read(
            data.buf, (size_t)data.len, model.buf, channels_of(&model), workspace);
        Py_END_ALLOW_THREADS result = result_of(error);
    }
    PyMem_Free(workspace);
    PyBuffer_Release(&model);
    PyBuffer_Release(&data);
    return result;
}

static PyObject *run_encode(const Py_buffer *model, const Py_buffer *value, const Py_buffer *close)
{
    size_t channels, rows, size = 0;
    const int32_t *near;
    PyObject *result = NULL;
    if (!measure(model, value, &channels, &rows) || !near_of(close, rows, &near))
        return NULL;
    size_t bound = clgs_attributes_bound(model->buf, rows, channels);
    uint8_t *out = PyMem_Malloc(bound);
    void *workspace = workspace_new(clgs_attributes_workspace(rows, channels));
    if (!out || !workspace) {
        PyErr_NoMemory();
    } else {
        Py_BEGIN_ALLOW_THREADS size = clgs_attributes_encode(model->buf, value->buf, near, rows,
                                                             channels, out, bound, workspace);
        Py_END_ALLOW_THREADS result = bytes_of(out, size);
    }
    PyMem_Free(workspace);
    PyMem_Free(out);
    return result;
}

/* (model, value, near or None) -> bytes */
PyObject *attributes_encode(PyObject *module, PyObject *args)
{
    Py_buffer model, value, near;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*y*z*", &model, &value, &near))
        return NULL;
    PyObject *result = run_encode(&model, &value, &near);
    PyBuffer_Release(&near);
    PyBuffer_Release(&value);
    PyBuffer_Release(&model);
    return result;
}

static PyObject *run_decode(const Py_buffer *model, const Py_buffer *data, const Py_buffer *value,
                            const Py_buffer *close)
{
    size_t channels, rows;
    const int32_t *near;
    clgs_error error;
    if (!measure(model, value, &channels, &rows) || !near_of(close, rows, &near))
        return NULL;
    void *workspace = workspace_new(clgs_attributes_workspace(rows, channels));
    if (!workspace)
        return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS error = clgs_attributes_decode(
        model->buf, data->buf, (size_t)data->len, value->buf, near, rows, channels, workspace);
    Py_END_ALLOW_THREADS PyMem_Free(workspace);
    return result_of(error);
}

/* (model, data, value, near or None) -> None, the values filled */
PyObject *attributes_decode(PyObject *module, PyObject *args)
{
    Py_buffer model, data, value, near;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*y*w*z*", &model, &data, &value, &near))
        return NULL;
    PyObject *result = run_decode(&model, &data, &value, &near);
    PyBuffer_Release(&near);
    PyBuffer_Release(&value);
    PyBuffer_Release(&data);
    PyBuffer_Release(&model);
    return result;
}

static PyObject *run_count(const Py_buffer *model, const Py_buffer *value, const Py_buffer *count,
                           const Py_buffer *close)
{
    size_t channels, rows;
    const int32_t *near;
    clgs_error error = CLGS_ERROR_ARGUMENT;
    if (!measure(model, value, &channels, &rows) || !near_of(close, rows, &near))
        return NULL;
    if ((size_t)count->len != 4 * COUNTS * channels)
        return result_of(error);
    void *workspace = workspace_new(clgs_attributes_workspace(rows, channels));
    if (!workspace)
        return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS error =
        clgs_attributes_count(model->buf, value->buf, near, rows, channels, count->buf, workspace);
    Py_END_ALLOW_THREADS PyMem_Free(workspace);
    return result_of(error);
}

/* (model, value, count, near or None) -> None, the counts increased */
PyObject *attributes_count(PyObject *module, PyObject *args)
{
    Py_buffer model, value, count, near;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*y*w*z*", &model, &value, &count, &near))
        return NULL;
    PyObject *result = run_count(&model, &value, &count, &near);
    PyBuffer_Release(&near);
    PyBuffer_Release(&count);
    PyBuffer_Release(&value);
    PyBuffer_Release(&model);
    return result;
}

static PyObject *run_measure(const Py_buffer *model, const Py_buffer *value, const Py_buffer *bytes,
                             const Py_buffer *close)
{
    size_t channels, rows;
    const int32_t *near;
    clgs_error error = CLGS_ERROR_ARGUMENT;
    PyObject *result = NULL;
    if (!measure(model, value, &channels, &rows) || !near_of(close, rows, &near))
        return NULL;
    if ((size_t)bytes->len != 8 * channels)
        return result_of(error);
    uint8_t *out = PyMem_Malloc(clgs_attributes_measure_bound(rows));
    void *workspace = workspace_new(clgs_attributes_workspace(rows, channels));
    if (!out || !workspace) {
        PyErr_NoMemory();
    } else {
        Py_BEGIN_ALLOW_THREADS error = clgs_attributes_measure(
            model->buf, value->buf, near, rows, channels, bytes->buf, out, workspace);
        Py_END_ALLOW_THREADS result = result_of(error);
    }
    PyMem_Free(workspace);
    PyMem_Free(out);
    return result;
}

/* (model, value, bytes, near or None) -> None, the bytes of mixed channels added */
PyObject *attributes_measure(PyObject *module, PyObject *args)
{
    Py_buffer model, value, bytes, near;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*y*w*z*", &model, &value, &bytes, &near))
        return NULL;
    PyObject *result = run_measure(&model, &value, &bytes, &near);
    PyBuffer_Release(&near);
    PyBuffer_Release(&bytes);
    PyBuffer_Release(&value);
    PyBuffer_Release(&model);
    return result;
}

/* (model, count, scale, cost) -> None, classes and tables of the model and the costs filled */
PyObject *attributes_choose(PyObject *module, PyObject *args)
{
    Py_buffer model, count, cost;
    unsigned int scale;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(args, "w*y*Iw*", &model, &count, &scale, &cost))
        return NULL;
    size_t channels = channels_of(&model);
    void *workspace = workspace_new(clgs_attributes_choose_workspace());
    if (!workspace) {
        PyErr_NoMemory();
    } else if ((size_t)count.len != 4 * COUNTS * channels || (size_t)cost.len != 8 * channels) {
        result = result_of(CLGS_ERROR_ARGUMENT);
    } else {
        clgs_error error;
        Py_BEGIN_ALLOW_THREADS error =
            clgs_attributes_choose(model.buf, channels, count.buf, scale, cost.buf, workspace);
        Py_END_ALLOW_THREADS result = result_of(error);
    }
    PyMem_Free(workspace);
    PyBuffer_Release(&cost);
    PyBuffer_Release(&count);
    PyBuffer_Release(&model);
    return result;
}

/* (position, near) -> None, the near rows filled */
PyObject *attributes_near(PyObject *module, PyObject *args)
{
    Py_buffer position, near;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*w*", &position, &near))
        return NULL;
    size_t rows = (size_t)position.len / 12;
    void *workspace = workspace_new(clgs_near_workspace(rows));
    if (!workspace) {
        PyErr_NoMemory();
    } else if ((size_t)position.len != 12 * rows || (size_t)near.len != 4 * CLGS_NEAR * rows) {
        result = result_of(CLGS_ERROR_ARGUMENT);
    } else {
        clgs_error error;
        Py_BEGIN_ALLOW_THREADS error = clgs_near(position.buf, rows, near.buf, workspace);
        Py_END_ALLOW_THREADS result = result_of(error);
    }
    PyMem_Free(workspace);
    PyBuffer_Release(&near);
    PyBuffer_Release(&position);
    return result;
}
