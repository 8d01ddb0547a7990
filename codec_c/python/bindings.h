/* What the sources of the extension module share. */
#ifndef CLGS_BINDINGS_H
#define CLGS_BINDINGS_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030b0000
#include <Python.h>

#include "clgs_codec.h"

/* Memory that a call works in, for PyMem_Free, or NULL. Large blocks are of huge pages if the
 * system has some: to touch thousands of small ones costs a tenth of an octree's time. */
void *workspace_new(size_t size);

PyObject *attributes_header(PyObject *module, PyObject *args);
PyObject *attributes_read(PyObject *module, PyObject *args);
PyObject *attributes_encode(PyObject *module, PyObject *args);
PyObject *attributes_decode(PyObject *module, PyObject *args);
PyObject *attributes_count(PyObject *module, PyObject *args);
PyObject *attributes_measure(PyObject *module, PyObject *args);
PyObject *attributes_choose(PyObject *module, PyObject *args);
PyObject *attributes_near(PyObject *module, PyObject *args);

PyObject *weights_encode(PyObject *module, PyObject *args);
PyObject *weights_decode(PyObject *module, PyObject *args);

#endif
