//! Stanford PLY files, ASCII and binary of either order of bytes: positions of vertices and corners of faces; other
//! properties and elements are passed.
//!
//! Entry point: [`read_ply`]. Format: Turk 1994, The PLY polygon file format.

use super::{MOST_CORNERS, TriangleMesh};
use crate::MeshError;
use crate::read::{Coding, Endian, Kind, Number, Scan};

/// A kind of things in a file.
struct Element<'a> {
    name: &'a str,
    count: u64,
    properties: Vec<Property<'a>>,
}

/// What each of them has: one number, or a list of as many as the number before it says.
struct Property<'a> {
    name: &'a str,
    count: Option<Kind>,
    kind: Kind,
}

/// Reads a file, in its own unit of length.
///
/// # Errors
/// A [`MeshError`] with the line or byte of what cannot be read.
pub(super) fn read_ply(bytes: &[u8]) -> Result<TriangleMesh, MeshError> {
    let mut file = Scan::new(bytes, Coding::Lines, None);
    let elements = read_head(&mut file)?;
    let has = |name: &str| elements.iter().any(|element| element.name == name);
    if !has("vertex") {
        return Err(MeshError::NoSection("element vertex"));
    }
    if !has("face") {
        return Err(MeshError::NoSection("element face"));
    }
    let mut surface = TriangleMesh::default();
    for element in elements
        .iter()
        .filter(|element| !element.properties.is_empty())
    {
        let numbers = &mut vec![Vec::new(); element.properties.len()][..];
        match element.name {
            "vertex" => read_vertices(&mut file, element, numbers, &mut surface)?,
            "face" => read_faces(&mut file, element, numbers, &mut surface)?,
            _ => {
                for _ in 0..element.count {
                    read_one(&mut file, element, numbers)?;
                }
            }
        }
    }
    Ok(surface)
}

/// Reads up to the end of the head, and sets the coding of what follows.
fn read_head<'a>(file: &mut Scan<'a>) -> Result<Vec<Element<'a>>, MeshError> {
    let mut elements: Vec<Element> = Vec::new();
    let mut coding = None;
    file.keyword("ply")?;
    file.end_text("the end of the line")?;
    loop {
        file.record("end_header")?;
        match file.word("a line of the head")? {
            "format" => {
                coding = Some(match file.word("ascii or binary_little_endian")? {
                    "ascii" => Coding::Words,
                    "binary_little_endian" => Coding::Binary(Endian::Little),
                    "binary_big_endian" => Coding::Binary(Endian::Big),
                    word => {
                        return Err(
                            file.expected("ascii, binary_little_endian or binary_big_endian", word)
                        );
                    }
                });
            }
            "element" => elements.push(Element {
                name: file.word("the name of an element")?,
                count: file.text_index("how many of them there are")?,
                properties: Vec::new(),
            }),
            "property" => {
                let property = read_property(file)?;
                match elements.last_mut() {
                    Some(element) => element.properties.push(property),
                    None => return Err(file.expected("an element first", "property")),
                }
            }
            "comment" | "obj_info" => {}
            "end_header" => break,
            word => return Err(file.expected("format, element, property or end_header", word)),
        }
        file.next_line();
    }
    file.end_text("the end of the line")?;
    file.coding = coding.ok_or(MeshError::NoSection("format"))?;
    Ok(elements)
}

fn read_property<'a>(file: &mut Scan<'a>) -> Result<Property<'a>, MeshError> {
    let kind = |file: &mut Scan<'a>, word: &str| match word {
        "char" | "int8" => Ok(Kind::I8),
        "uchar" | "uint8" => Ok(Kind::U8),
        "short" | "int16" => Ok(Kind::I16),
        "ushort" | "uint16" => Ok(Kind::U16),
        "int" | "int32" => Ok(Kind::I32),
        "uint" | "uint32" => Ok(Kind::U32),
        "float" | "float32" => Ok(Kind::F32),
        "double" | "float64" => Ok(Kind::F64),
        word => Err(file.expected("a type of numbers, such as float", word)),
    };
    let what = "a type of numbers";
    let first = file.word(what)?;
    let count = match first {
        "list" => {
            let word = file.word(what)?;
            Some(kind(file, word)?)
        }
        _ => None,
    };
    let word = if count.is_some() {
        file.word(what)?
    } else {
        first
    };
    Ok(Property {
        kind: kind(file, word)?,
        count,
        name: file.word("the name of a property")?,
    })
}

/// The numbers of one thing, of each property; of a list no more than the corners of a face can be, and one.
fn read_one(
    file: &mut Scan,
    element: &Element,
    numbers: &mut [Vec<Number>],
) -> Result<(), MeshError> {
    file.record(element.name)?;
    for (property, numbers) in element.properties.iter().zip(numbers) {
        numbers.clear();
        let count = match property.count {
            Some(kind) => file.index(kind, "how many numbers follow")?,
            None => 1,
        };
        for _ in 0..count {
            let number = file.number(property.kind, property.name)?;
            if numbers.len() <= MOST_CORNERS {
                numbers.push(number);
            }
        }
    }
    Ok(())
}

/// Where a property is among those of its element.
fn place(element: &Element, names: &[&str], is_list: bool) -> Option<usize> {
    let is_it = |own: &Property| names.contains(&own.name) && own.count.is_some() == is_list;
    element.properties.iter().position(is_it)
}

fn read_vertices(
    file: &mut Scan,
    element: &Element,
    numbers: &mut [Vec<Number>],
    surface: &mut TriangleMesh,
) -> Result<(), MeshError> {
    let axis = |name| place(element, &[name], false);
    let (Some(x), Some(y), Some(z)) = (axis("x"), axis("y"), axis("z")) else {
        return Err(MeshError::NoSection(
            "properties x, y and z of its vertices",
        ));
    };
    for _ in 0..element.count {
        read_one(file, element, numbers)?;
        surface
            .points_m
            .push([x, y, z].map(|k| numbers[k][0].real()));
    }
    Ok(())
}

fn read_faces(
    file: &mut Scan,
    element: &Element,
    numbers: &mut [Vec<Number>],
    surface: &mut TriangleMesh,
) -> Result<(), MeshError> {
    let Some(list) = place(element, &["vertex_indices", "vertex_index"], true) else {
        return Err(MeshError::NoSection("list vertex_indices of its faces"));
    };
    let mut corners = Vec::new();
    for face in 0..element.count {
        read_one(file, element, numbers)?;
        let points = surface.points_m.len();
        corners.clear();
        for number in &numbers[list] {
            let index = number.index().filter(|index| *index < points as u64);
            let what = || {
                file.expected(
                    &format!("one of the {points} vertices, from 0"),
                    &number.real().to_string(),
                )
            };
            corners.push(index.ok_or_else(what)? as u32);
        }
        surface.push_face(file, face as u32, &corners)?;
    }
    Ok(())
}
