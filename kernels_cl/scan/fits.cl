/* Whether what is counted fits. One work-item; no local memory. */
#ifndef LACKS_ROOM
#define LACKS_ROOM 2
#endif

/* Copies three totals to one array, and sets LACKS_ROOM in *stop if one is above its capacity. */
__kernel void scan_fits(__global const long *first, __global const long *second,
                        __global const long *third, const long4 capacity, __global long *totals,
                        __global int *stop)
{
    totals[0] = *first;
    totals[1] = *second;
    totals[2] = *third;
    if (*first > capacity.x || *second > capacity.y || *third > capacity.z)
        atomic_or(stop, LACKS_ROOM);
}
