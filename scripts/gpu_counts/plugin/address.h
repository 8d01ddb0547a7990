// Address arithmetic that a GPU does not repeat: its loads and stores add a constant of their own.
#pragma once

#include "llvm/IR/Constants.h"
#include "llvm/IR/Instructions.h"

namespace gpu_counts
{

// The part of an index that no constant of the access can stand for.
inline const llvm::Value *variable_part(const llvm::Value *index)
{
    while (const auto *one = llvm::dyn_cast<llvm::Instruction>(index)) {
        const unsigned code = one->getOpcode();
        const bool widens = code == llvm::Instruction::SExt || code == llvm::Instruction::ZExt;
        const bool adds = code == llvm::Instruction::Add || code == llvm::Instruction::Or;
        if (!widens && !(adds && llvm::isa<llvm::ConstantInt>(one->getOperand(1))))
            break;
        index = one->getOperand(0);
    }
    return llvm::isa<llvm::ConstantInt>(index) ? nullptr : index;
}

inline bool same_address(const llvm::GetElementPtrInst *one, const llvm::GetElementPtrInst *other)
{
    if (one->getSourceElementType() != other->getSourceElementType() ||
        one->getPointerOperand() != other->getPointerOperand() ||
        one->getNumIndices() != other->getNumIndices())
        return false;
    for (unsigned i = 1; i <= one->getNumIndices(); ++i)
        if (variable_part(one->getOperand(i)) != variable_part(other->getOperand(i)))
            return false;
    return true;
}

// Whether an address is computed again: not if it is constant, or if one before it in the block
// differs by a constant.
inline bool is_new_address(const llvm::GetElementPtrInst *address)
{
    if (address->hasAllConstantIndices())
        return false;
    for (const llvm::Instruction &before : *address->getParent()) {
        if (&before == address)
            break;
        const auto *other = llvm::dyn_cast<llvm::GetElementPtrInst>(&before);
        if (other && same_address(other, address))
            return false;
    }
    return true;
}

// Whether a sum with a constant, or what it is widened to, only goes into addresses.
inline bool goes_into_addresses(const llvm::Instruction *index)
{
    for (const llvm::User *user : index->users()) {
        const bool widens = llvm::isa<llvm::SExtInst>(user) || llvm::isa<llvm::ZExtInst>(user);
        if (widens ? !goes_into_addresses(llvm::cast<llvm::Instruction>(user))
                   : !llvm::isa<llvm::GetElementPtrInst>(user))
            return false;
    }
    return true;
}

inline bool is_offset(const llvm::Instruction *sum)
{
    return llvm::isa<llvm::ConstantInt>(sum->getOperand(1)) && goes_into_addresses(sum);
}

} // namespace gpu_counts
