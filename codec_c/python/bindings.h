/* What the sources of the extension module share. */
#ifndef CLGS_BINDINGS_H
#define CLGS_BINDINGS_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

#include "clgs_codec.h"

PyObject *attributes_header(PyObject *module, PyObject *args);
PyObject *attributes_read(PyObject *module, PyObject *args);
PyObject *attributes_encode(PyObject *module, PyObject *args);
PyObject *attributes_decode(PyObject *module, PyObject *args);
PyObject *attributes_count(PyObject *module, PyObject *args);
PyObject *attributes_measure(PyObject *module, PyObject *args);
PyObject *attributes_choose(PyObject *module, PyObject *args);

PyObject *weights_encode(PyObject *module, PyObject *args);
PyObject *weights_decode(PyObject *module, PyObject *args);

#endif
