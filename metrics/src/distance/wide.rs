//! The same work compiled for processors with AVX2 and AVX-512, chosen while running. Same bits:
//! these widen the operations and change none; fused multiply-add is not asked for.
#![allow(
    unsafe_code,
    reason = "a function for a newer processor may only be called after asking for it"
)]

/// Work whose loops over columns gain from wide registers. What `run` calls must be inlined into it.
pub(super) trait Task {
    /// What it gives.
    type Output;

    /// Does it.
    fn run(self) -> Self::Output;
}

/// Does the work with the widest registers that the processor has.
#[cfg(target_arch = "x86_64")]
pub(super) fn run<T: Task>(task: T) -> T::Output {
    if std::arch::is_x86_feature_detected!("avx512f")
        && std::arch::is_x86_feature_detected!("avx512vl")
        && std::arch::is_x86_feature_detected!("avx512dq")
    {
        // SAFETY: the processor has these, as it just said.
        unsafe { x86::with_avx512(task) }
    } else if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2, as it just said.
        unsafe { x86::with_avx2(task) }
    } else {
        task.run()
    }
}

/// Other processors take what the compiler takes for granted.
#[cfg(not(target_arch = "x86_64"))]
pub(super) fn run<T: Task>(task: T) -> T::Output {
    task.run()
}

#[cfg(target_arch = "x86_64")]
pub(super) mod x86 {
    use super::Task;

    #[target_feature(enable = "avx512f,avx512vl,avx512dq")]
    pub(in super::super) fn with_avx512<T: Task>(task: T) -> T::Output {
        task.run()
    }

    #[target_feature(enable = "avx2")]
    pub(in super::super) fn with_avx2<T: Task>(task: T) -> T::Output {
        task.run()
    }
}
