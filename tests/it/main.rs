//! Why to believe it: one integration binary.

mod architecture;
