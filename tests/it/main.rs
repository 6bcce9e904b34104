//! Why to believe it: one integration binary.
