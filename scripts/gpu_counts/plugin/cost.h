// What an instruction of LLVM's costs a lane of a GPU: issued instructions, floating-point
// operations (two of an fma) and special functions.
//
// The weights are those of NVIDIA's code for the same operation, rounded: an exact division is a
// reciprocal and Newton's steps, an address one multiply-add, a conversion of registers nothing.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <map>
#include <string>

#include "llvm/IR/Constants.h"
#include "llvm/IR/DerivedTypes.h"
#include "llvm/IR/Instructions.h"

#include "address.h"

namespace gpu_counts
{

struct Cost {
    uint32_t issued = 0, operations = 0, special = 0;
};

constexpr unsigned PRIVATE = 0, GLOBAL = 1, CONSTANT = 2, LOCAL = 3;
constexpr uint32_t DIVISION = 9, ROOT = 8, INTEGER_DIVISION = 18, BY_CONSTANT = 4;
constexpr uint32_t LONG_DIVISION = 24; // of numbers that fit in 32 bits, which is tested

inline uint32_t elements(const llvm::Type *type)
{
    const auto *vector = llvm::dyn_cast<llvm::FixedVectorType>(type);
    return vector ? vector->getNumElements() : 1;
}

// Registers of 32 bits that a value takes.
inline uint32_t registers(const llvm::Type *type)
{
    return elements(type) * (type->getScalarSizeInBits() > 32 ? 2 : 1);
}

// "fma" of "_Z3fmafff"; names that are not mangled stay as they are.
inline std::string plain_name(const std::string &name)
{
    if (name.compare(0, 2, "_Z") != 0)
        return name;
    char *end = nullptr;
    const long length = std::strtol(name.c_str() + 2, &end, 10);
    return std::string(end).substr(0, static_cast<size_t>(length));
}

inline bool starts(const std::string &name, const char *prefix)
{
    return name.rfind(prefix, 0) == 0;
}

// Per element of the result.
inline Cost builtin_cost(const std::string &name)
{
    static const std::map<std::string, Cost> known = {
        {"fma", {1, 2, 0}},
        {"mad", {1, 2, 0}},
        {"exp", {6, 2, 1}},
        {"exp2", {4, 1, 1}},
        {"native_exp", {2, 1, 1}},
        {"native_exp2", {1, 0, 1}},
        {"log", {6, 2, 1}},
        {"log2", {4, 1, 1}},
        {"sqrt", {ROOT, 1, 1}},
        {"rsqrt", {2, 1, 1}},
        {"tanh", {8, 4, 2}},
        {"pow", {20, 8, 2}},
        {"clamp", {2, 0, 0}},
        {"get_global_id", {2, 0, 0}},
        {"get_global_size", {0, 0, 0}},
        {"get_local_size", {0, 0, 0}},
        {"get_num_groups", {0, 0, 0}},
    };
    const auto found = known.find(name);
    return found == known.end() ? Cost{1, 0, 0} : found->second;
}

inline Cost intrinsic_cost(const std::string &name)
{
    for (const char *free : {"llvm.lifetime", "llvm.dbg", "llvm.fabs", "llvm.assume",
                             "llvm.experimental", "llvm.memcpy", "llvm.memset", "llvm.memmove"})
        if (starts(name, free))
            return {0, 0, 0};
    if (starts(name, "llvm.fmuladd"))
        return {1, 2, 0};
    return {1, 0, 0};
}

inline unsigned address_space(const llvm::Value *pointer)
{
    return pointer->getType()->getPointerAddressSpace();
}

// vloadn and vstoren know no alignment but that of an element: one access of each.
inline uint32_t vector_accesses(const llvm::CallInst *call, const std::string &name)
{
    const bool load = starts(name, "vload");
    const llvm::Value *pointer = call->getArgOperand(load ? 1 : 2);
    const llvm::Type *type = load ? call->getType() : call->getArgOperand(0)->getType();
    return address_space(pointer) == PRIVATE ? 0 : elements(type);
}

inline Cost call_cost(const llvm::CallInst *call)
{
    const llvm::Function *function = call->getCalledFunction();
    if (!function)
        return {1, 0, 0};
    const std::string name = plain_name(function->getName().str());
    if (starts(name, "vload") || starts(name, "vstore"))
        return {vector_accesses(call, name), 0, 0};
    const Cost one = starts(name, "llvm.") ? intrinsic_cost(name) : builtin_cost(name);
    const uint32_t n = call->getType()->isVoidTy() ? 1 : elements(call->getType());
    return {n * one.issued, n * one.operations, n * one.special};
}

// Elements of an access that must be made one by one, for want of alignment.
inline uint32_t split_accesses(const llvm::Type *type, uint64_t alignment, unsigned space)
{
    if (space == PRIVATE)
        return 0;
    const uint64_t bytes = uint64_t{elements(type)} * (type->getScalarSizeInBits() / 8);
    const uint64_t widest = alignment < 16 ? alignment : 16;
    return widest && bytes > widest ? static_cast<uint32_t>((bytes + widest - 1) / widest) : 1;
}

inline Cost division_cost(const llvm::Instruction *instruction)
{
    const llvm::Type *type = instruction->getType();
    if (llvm::isa<llvm::Constant>(instruction->getOperand(1)))
        return {registers(type) * BY_CONSTANT, 0, 0};
    const bool wide = type->getScalarSizeInBits() > 32;
    return {elements(type) * (wide ? LONG_DIVISION : INTEGER_DIVISION), 0, 0};
}

inline Cost cost_of(const llvm::Instruction *instruction)
{
    using llvm::Instruction;
    const uint32_t n = instruction->getType()->isVoidTy() ? 1 : registers(instruction->getType());
    switch (instruction->getOpcode()) {
    case Instruction::FAdd:
    case Instruction::FSub:
    case Instruction::FMul:
        return {n, n, 0};
    case Instruction::FDiv:
        return {n * DIVISION, n, n};
    case Instruction::FRem:
        return {n * INTEGER_DIVISION, n, n};
    case Instruction::UDiv:
    case Instruction::SDiv:
    case Instruction::URem:
    case Instruction::SRem:
        return division_cost(instruction);
    case Instruction::ICmp:
    case Instruction::FCmp:
        return {registers(instruction->getOperand(0)->getType()), 0, 0};
    case Instruction::GetElementPtr:
        return {is_new_address(llvm::cast<llvm::GetElementPtrInst>(instruction)) ? 1u : 0u, 0, 0};
    case Instruction::Add:
    case Instruction::Or:
        return {is_offset(instruction) ? 0u : n, 0, 0};
    case Instruction::Load: {
        const auto *load = llvm::cast<llvm::LoadInst>(instruction);
        return {split_accesses(load->getType(), load->getAlign().value(),
                               load->getPointerAddressSpace()),
                0, 0};
    }
    case Instruction::Store: {
        const auto *store = llvm::cast<llvm::StoreInst>(instruction);
        return {split_accesses(store->getValueOperand()->getType(), store->getAlign().value(),
                               store->getPointerAddressSpace()),
                0, 0};
    }
    case Instruction::Br:
        return {llvm::cast<llvm::BranchInst>(instruction)->isConditional() ? 1u : 0u, 0, 0};
    case Instruction::Switch:
        return {2, 0, 0};
    case Instruction::Call:
        return call_cost(llvm::cast<llvm::CallInst>(instruction));
    case Instruction::PHI:
    case Instruction::Alloca:
    case Instruction::BitCast:
    case Instruction::AddrSpaceCast:
    case Instruction::IntToPtr:
    case Instruction::PtrToInt:
    case Instruction::Trunc:
    case Instruction::ZExt:
    case Instruction::SExt:
    case Instruction::FNeg:
    case Instruction::Freeze:
    case Instruction::Ret:
    case Instruction::Unreachable:
    case Instruction::ExtractElement:
    case Instruction::InsertElement:
    case Instruction::ShuffleVector:
    case Instruction::ExtractValue:
    case Instruction::InsertValue:
        return {0, 0, 0};
    default: // arithmetic, logic, conversions
        return {n, 0, 0};
    }
}

// Of all instructions of a function and of those that it calls, as if each ran once.
inline uint64_t static_cost(const llvm::Function *function)
{
    uint64_t sum = 0;
    for (const llvm::BasicBlock &block : *function)
        for (const llvm::Instruction &one : block) {
            const auto *call = llvm::dyn_cast<llvm::CallInst>(&one);
            const bool own =
                call && call->getCalledFunction() && !call->getCalledFunction()->isDeclaration();
            sum += cost_of(&one).issued + (own ? static_cost(call->getCalledFunction()) : 0);
        }
    return sum;
}

} // namespace gpu_counts
