/* Methods for weights; layers are a buffer of uint32 pairs (rows, columns). */
#include "bindings.h"

typedef struct weights_job {
    Py_buffer data, word, layer;
    size_t layers, bound;
} weights_job;

/* Checks that the layers hold all words; 0 and an exception if they do not. */
static int measure(weights_job *job)
{
    job->layers = (size_t)job->layer.len / sizeof(clgs_layer);
    if ((size_t)job->layer.len % sizeof(clgs_layer) == 0)
        job->bound = clgs_weights_bound(job->layer.buf, job->layers);
    if (job->bound > 0 && (size_t)job->word.len == job->bound - 1)
        return 1;
    PyErr_SetString(PyExc_ValueError, "the layers do not hold as many weights as there are words");
    return 0;
}

static PyObject *run_encode(weights_job *job)
{
    PyObject *result = NULL;
    size_t size = 0;
    uint8_t *out = PyMem_Malloc(job->bound);
    void *workspace = workspace_new(clgs_weights_workspace(job->layer.buf, job->layers));
    if (!out || !workspace) {
        PyErr_NoMemory();
    } else {
        Py_BEGIN_ALLOW_THREADS size = clgs_weights_encode(job->word.buf, job->layer.buf,
                                                          job->layers, out, job->bound, workspace);
        Py_END_ALLOW_THREADS result =
            PyBytes_FromStringAndSize((const char *)out, (Py_ssize_t)size);
    }
    PyMem_Free(workspace);
    PyMem_Free(out);
    return result;
}

static PyObject *run_decode(weights_job *job)
{
    clgs_error error;
    void *workspace = workspace_new(clgs_weights_workspace(job->layer.buf, job->layers));
    if (!workspace)
        return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS error =
        clgs_weights_decode(job->data.buf, (size_t)job->data.len, job->word.buf, job->layer.buf,
                            job->layers, workspace);
    Py_END_ALLOW_THREADS PyMem_Free(workspace);
    if (error == CLGS_OK)
        return Py_NewRef(Py_None);
    PyErr_SetString(PyExc_ValueError, clgs_error_text(error));
    return NULL;
}

PyObject *weights_encode(PyObject *module, PyObject *args)
{
    weights_job job = {0};
    (void)module;
    if (!PyArg_ParseTuple(args, "y*y*", &job.word, &job.layer))
        return NULL;
    PyObject *result = measure(&job) ? run_encode(&job) : NULL;
    PyBuffer_Release(&job.layer);
    PyBuffer_Release(&job.word);
    return result;
}

PyObject *weights_decode(PyObject *module, PyObject *args)
{
    weights_job job = {0};
    (void)module;
    if (!PyArg_ParseTuple(args, "y*w*y*", &job.data, &job.word, &job.layer))
        return NULL;
    PyObject *result = measure(&job) ? run_decode(&job) : NULL;
    PyBuffer_Release(&job.layer);
    PyBuffer_Release(&job.word);
    PyBuffer_Release(&job.data);
    return result;
}
