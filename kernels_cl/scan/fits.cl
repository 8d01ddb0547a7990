/* Whether what is counted fits. One work-item; no local memory. */
#ifndef LACKS_ROOM
#define LACKS_ROOM 2
#endif

/* Sets LACKS_ROOM in *stop if more are needed than there is room for. */
__kernel void scan_fits(__global const long *total, const long capacity, __global int *stop)
{
    if (*total > capacity)
        atomic_or(stop, LACKS_ROOM);
}
