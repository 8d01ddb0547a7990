// What LLVM's optimiser makes and Oclgrind 21.10 does not know, or does wrong.
#pragma once

#include <cstdint>
#include <string>

#include "llvm/IR/Instructions.h"
#include "oclgrind.h"

namespace gpu_counts
{

using oclgrind::TypedValue;
using oclgrind::WorkItem;

constexpr unsigned BITS_OF_BYTE = 8;

inline uint64_t low_bits(uint64_t value, unsigned bits)
{
    return bits == 64 ? value : value & ((uint64_t{1} << bits) - 1);
}

// Calls `one(operands, bits)` for every element of the result.
template <typename One>
void each_element(WorkItem *item, const llvm::CallInst *call, TypedValue &result, One one)
{
    const unsigned bits = result.size * BITS_OF_BYTE, count = call->arg_size();
    for (unsigned i = 0; i < result.num; ++i) {
        uint64_t operand[3] = {0, 0, 0};
        for (unsigned k = 0; k < count && k < 3; ++k) {
            const TypedValue value = item->getOperand(call->getArgOperand(k));
            operand[k] = low_bits(value.getUInt(i < value.num ? i : 0), bits);
        }
        result.setUInt(low_bits(one(operand, bits), bits), i);
    }
}

inline uint64_t leading_zeros(uint64_t x, unsigned bits)
{
    unsigned zeros = 0;
    while (zeros < bits && !(x >> (bits - 1 - zeros) & 1))
        ++zeros;
    return zeros;
}

inline uint64_t trailing_zeros(uint64_t x, unsigned bits)
{
    unsigned zeros = 0;
    while (zeros < bits && !(x >> zeros & 1))
        ++zeros;
    return zeros;
}

inline uint64_t absolute(uint64_t x, unsigned bits)
{
    return x >> (bits - 1) & 1 ? ~x + 1 : x;
}

inline uint64_t funnel_left(const uint64_t *x, unsigned bits)
{
    const unsigned by = static_cast<unsigned>(x[2] % bits);
    return by ? x[0] << by | x[1] >> (bits - by) : x[0];
}

inline uint64_t funnel_right(const uint64_t *x, unsigned bits)
{
    const unsigned by = static_cast<unsigned>(x[2] % bits);
    return by ? x[0] << (bits - by) | x[1] >> by : x[1];
}

inline void nothing(WorkItem *, const llvm::CallInst *, const std::string &, const std::string &,
                    TypedValue &, void *)
{
}

#define ELEMENTWISE(name, expression)                                                              \
    inline void name(WorkItem *item, const llvm::CallInst *call, const std::string &,              \
                     const std::string &, TypedValue &result, void *)                              \
    {                                                                                              \
        each_element(item, call, result,                                                           \
                     [](const uint64_t *x, unsigned bits) { return (void)bits, (expression); });   \
    }
ELEMENTWISE(run_abs, absolute(x[0], bits))
ELEMENTWISE(run_ctlz, leading_zeros(x[0], bits))
ELEMENTWISE(run_cttz, trailing_zeros(x[0], bits))
ELEMENTWISE(run_ctpop, static_cast<uint64_t>(__builtin_popcountll(x[0])))
ELEMENTWISE(run_fshl, funnel_left(x, bits))
ELEMENTWISE(run_fshr, funnel_right(x, bits))
ELEMENTWISE(run_usub_sat, x[0] > x[1] ? x[0] - x[1] : 0)
#undef ELEMENTWISE

inline void add_missing_intrinsics()
{
    const std::pair<const char *, decltype(&nothing)> missing[] = {
        {"llvm.experimental.noalias.scope.decl", nothing},
        {"llvm.abs.", run_abs},
        {"llvm.ctlz.", run_ctlz},
        {"llvm.cttz.", run_cttz},
        {"llvm.ctpop.", run_ctpop},
        {"llvm.fshl.", run_fshl},
        {"llvm.fshr.", run_fshr},
        {"llvm.usub.sat.", run_usub_sat},
    };
    for (const auto &one : missing)
        oclgrind::workItemPrefixBuiltins.push_back(
            {one.first, oclgrind::BuiltinFunction(one.second, nullptr)});
}

// Comparisons of vectors give Oclgrind -1, constants are 1, and so their `xor` never false: what
// the optimiser makes of a negation. The lowest bit is right.
inline void mend_truth(const llvm::Type *type, const TypedValue &result)
{
    if (!type->isVectorTy() || !type->isIntOrIntVectorTy(1))
        return;
    for (unsigned i = 0; i < result.num * result.size; ++i)
        result.data[i] = result.data[i] & 1 ? 0xff : 0;
}

} // namespace gpu_counts
