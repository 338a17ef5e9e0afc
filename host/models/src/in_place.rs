//! Clones that take over the memory of what they replace.
//!
//! Entry point: `clone_in_place`. A derived `clone_from` makes a new clone; a state that is put aside and taken up again
//! within a step must not allocate.

/// `Clone` for a struct of these fields, with a `clone_from` that is each field's own.
macro_rules! clone_in_place {
    ($of:ty { $($field:ident),* $(,)? }) => {
        impl Clone for $of {
            fn clone(&self) -> Self {
                Self {
                    $($field: Clone::clone(&self.$field)),*
                }
            }

            fn clone_from(&mut self, source: &Self) {
                $(Clone::clone_from(&mut self.$field, &source.$field);)*
            }
        }
    };
}

pub(crate) use clone_in_place;
