//! A list of bounded length for messages: only what is used travels.
//!
//! Entry point: [`List`]. On the wire it is postcard's sequence: a varint of the length, then the items.

use core::{fmt, marker::PhantomData};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::{
    Schema,
    schema::{DataModelType, NamedType},
};
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{Error, SeqAccess, Visitor},
};

/// Up to `N` items.
#[derive(Clone, Copy)]
pub struct List<T, const N: usize> {
    items: [T; N],
    count: usize,
}

impl<T: Copy + Default, const N: usize> List<T, N> {
    /// No items.
    pub fn new() -> Self {
        List {
            items: [T::default(); N],
            count: 0,
        }
    }

    /// Adds an item at the end; false, and nothing changes, if there is no room.
    pub fn push(&mut self, item: T) -> bool {
        let Some(place) = self.items.get_mut(self.count) else {
            return false;
        };
        *place = item;
        self.count += 1;
        true
    }

    /// A list of the first `N` of `items`.
    pub fn of(items: impl IntoIterator<Item = T>) -> Self {
        let mut list = List::new();
        for item in items {
            if !list.push(item) {
                break;
            }
        }
        list
    }
}

impl<T, const N: usize> List<T, N> {
    /// The items.
    pub fn items(&self) -> &[T] {
        self.items.get(..self.count).unwrap_or_default()
    }

    /// The items, to change.
    pub fn items_mut(&mut self) -> &mut [T] {
        self.items.get_mut(..self.count).unwrap_or_default()
    }
}

impl<T: Copy + Default, const N: usize> Default for List<T, N> {
    fn default() -> Self {
        List::new()
    }
}

/// Places beyond the length do not count.
impl<T: PartialEq, const N: usize> PartialEq for List<T, N> {
    fn eq(&self, other: &Self) -> bool {
        self.items() == other.items()
    }
}

impl<T: fmt::Debug, const N: usize> fmt::Debug for List<T, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.items().fmt(f)
    }
}

impl<T: MaxSize, const N: usize> MaxSize for List<T, N> {
    const POSTCARD_MAX_SIZE: usize = varint_size(N) + N * T::POSTCARD_MAX_SIZE;
}

/// Bytes of a varint.
const fn varint_size(mut value: usize) -> usize {
    let mut size = 1;
    while value >= 0x80 {
        value >>= 7;
        size += 1;
    }
    size
}

impl<T: Schema, const N: usize> Schema for List<T, N> {
    const SCHEMA: &'static NamedType = &NamedType {
        name: "List",
        ty: &DataModelType::Seq(T::SCHEMA),
    };
}

impl<T: Serialize, const N: usize> Serialize for List<T, N> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.items())
    }
}

impl<'de, T: Deserialize<'de> + Copy + Default, const N: usize> Deserialize<'de> for List<T, N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(Items(PhantomData))
    }
}

struct Items<T, const N: usize>(PhantomData<T>);

impl<'de, T: Deserialize<'de> + Copy + Default, const N: usize> Visitor<'de> for Items<T, N> {
    type Value = List<T, N>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at most {N} items")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Self::Value, A::Error> {
        let mut list = List::new();
        while let Some(item) = items.next_element()? {
            if !list.push(item) {
                return Err(A::Error::custom("too many items"));
            }
        }
        Ok(list)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_used_travels() {
        let list: List<u32, 3> = List::of([1, 300]);
        let mut buffer = [0; 16];
        let bytes = postcard::to_slice(&list, &mut buffer).expect("fits");
        assert_eq!(*bytes, [2, 1, 0xac, 2]);
        assert_eq!(postcard::from_bytes(bytes), Ok(list));
        assert_eq!(List::<u32, 3>::POSTCARD_MAX_SIZE, 1 + 3 * 5);
        assert_eq!(List::<f32, 300>::POSTCARD_MAX_SIZE, 2 + 300 * 4);
    }

    #[test]
    fn a_longer_list_does_not_fit() {
        let mut list: List<u8, 2> = List::of([7, 8, 9]);
        assert_eq!(list.items(), [7, 8]);
        assert!(!list.push(9));
        assert!(postcard::from_bytes::<List<u8, 2>>(&[3, 7, 8, 9]).is_err());
        assert!(postcard::from_bytes::<List<u8, 2>>(&[2, 7]).is_err());
        // A length beyond any memory must not be believed.
        let endless = [0xff, 0xff, 0xff, 0xff, 0x0f];
        assert!(postcard::from_bytes::<List<u8, 2>>(&endless).is_err());
    }
}
