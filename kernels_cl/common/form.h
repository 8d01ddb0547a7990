/* The form of the kernels, a build option (clgs/opencl/device.py): USE_LOCAL 0 for CPUs, one
 * work-item per unit of work and no local memory; USE_LOCAL 1 for GPUs, work-groups with local
 * memory. How many lanes a vector has is VEC, in common/real.h. */
#ifndef CLGS_FORM_H
#define CLGS_FORM_H

#ifndef USE_LOCAL
#define USE_LOCAL 0
#endif

/* Stands before a kernel whose work-groups have this many work-items: a compiler can give each of
 * them the registers that there are, and a driver refuses sizes that would give wrong sums. */
#define GROUP_OF(items) __attribute__((reqd_work_group_size((items), 1, 1)))

#endif
