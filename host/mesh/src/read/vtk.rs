//! Reads legacy `.vtk` files, text and bytes: unstructured grids, of whose cells the tetrahedra are taken.
//!
//! Entry point: [`read_vtk`]. Format: VTK File Formats 4.2, "Simple Legacy Formats", and the
//! `OFFSETS`/`CONNECTIVITY` cells of version 5.

use super::super::{MeshError, Place, RawMesh};
use super::gather::{Gather, Shape};
use super::regions::{Head, RegionArrays};
use super::scan::{Coding, Endian, Kind, Scan};

/// Reads a file, in its own unit of length.
///
/// Points, lines and faces are left out. Regions are those of the cell array of the name `region_array`, or of a
/// name that is known.
///
/// # Errors
/// A [`MeshError`] with the line or byte; volume cells other than tetrahedra are refused.
pub(super) fn read_vtk(bytes: &[u8], region_array: Option<&str>) -> Result<RawMesh, MeshError> {
    let mut file = Scan::new(bytes, Coding::Words, None);
    let head = String::from_utf8_lossy(file.rest_of_line()).into_owned();
    let Some(version) = head.strip_prefix("# vtk DataFile Version") else {
        return Err(file.expected("# vtk DataFile Version", &head));
    };
    let has_offsets = version.trim().starts_with('5');
    file.next_line();
    file.next_line(); // the title
    let what = "ASCII or BINARY";
    match file.word(what)? {
        "ASCII" => {}
        "BINARY" => file.coding = Coding::Binary(Endian::Big),
        other => return Err(file.expected(what, other)),
    }
    file.keyword("DATASET")?;
    file.keyword("UNSTRUCTURED_GRID")?;
    let mut grid = Grid::new(region_array);
    while let Some(word) = file.next_word() {
        match word {
            "POINTS" => {
                let count = file.text_index("the number of points")?;
                let kind = kind(&mut file)?;
                for _ in 0..count {
                    grid.points.push(file.point(kind)?);
                }
            }
            "CELLS" if has_offsets => grid.read_offsets(&mut file)?,
            "CELLS" => grid.read_cells(&mut file)?,
            "CELL_TYPES" => {
                let count = file.text_index("the number of cells")?;
                if file.coding != Coding::Words {
                    file.end_text("the end of the line")?;
                }
                for _ in 0..count {
                    let kind = file.index(Kind::I32, "the type of a cell")?;
                    grid.kinds.push((kind, file.place()));
                }
            }
            "CELL_DATA" | "POINT_DATA" => grid.read_data(&mut file, word)?,
            // A paragraph about the arrays before it, up to a blank line.
            "METADATA" => file.skip_paragraph(),
            // `FIELD` of the whole data set: names, counts and values, nothing that is needed here.
            "FIELD" => {
                if !file.skip_to("POINTS") {
                    break;
                }
                file.back_to_line();
            }
            other => {
                let what = "POINTS, CELLS, CELL_TYPES, CELL_DATA or POINT_DATA";
                return Err(file.expected(what, other));
            }
        }
    }
    grid.into_mesh(file.place())
}

/// The type of what comes, at the end of a line of text.
fn kind(file: &mut Scan) -> Result<Kind, MeshError> {
    let what = "a type such as double";
    let word = file.word(what)?;
    let kind = kind_of(word).ok_or_else(|| file.expected(what, word))?;
    if file.coding != Coding::Words {
        file.end_text("the end of the line")?;
    }
    Ok(kind)
}

fn kind_of(word: &str) -> Option<Kind> {
    Some(match word {
        "char" => Kind::I8,
        "unsigned_char" => Kind::U8,
        "short" => Kind::I16,
        "unsigned_short" => Kind::U16,
        "int" | "vtkIdType" | "vtktypeint32" => Kind::I32,
        "unsigned_int" | "vtktypeuint32" => Kind::U32,
        "long" | "vtktypeint64" => Kind::I64,
        "unsigned_long" | "vtktypeuint64" => Kind::U64,
        "float" => Kind::F32,
        "double" => Kind::F64,
        _ => return None,
    })
}

/// An unstructured grid as a file has it.
#[derive(Default)]
pub(super) struct Grid {
    pub points: Vec<[f64; 3]>,
    /// Nodes of every cell one after another, and where each ends.
    pub nodes: Vec<u64>,
    pub ends: Vec<usize>,
    /// Type of every cell, and where it stands.
    pub kinds: Vec<(u64, Place)>,
    pub regions: Vec<i64>,
    pub arrays: RegionArrays,
}

impl Grid {
    /// An empty one, whose regions are in the cell array of this name.
    pub fn new(region_array: Option<&str>) -> Self {
        Self {
            arrays: RegionArrays::new(region_array),
            ..Self::default()
        }
    }

    /// Cells of version 5: where each ends, from a 0 on, and the nodes of all.
    fn read_offsets(&mut self, file: &mut Scan) -> Result<(), MeshError> {
        let count = file.text_index("the number of offsets")?;
        let size = file.text_index("the number of nodes of all cells")?;
        file.keyword("OFFSETS")?;
        let offset = kind(file)?;
        for index in 0..count {
            let end = file.index(offset, "an offset")?;
            self.end(usize::try_from(end).unwrap_or(usize::MAX), index > 0, file)?;
        }
        file.keyword("CONNECTIVITY")?;
        let node = kind(file)?;
        for _ in 0..size {
            self.nodes.push(file.index(node, "a node of a cell")?);
        }
        Ok(())
    }

    /// One more end of a cell, or the start of the first.
    fn end(&mut self, end: usize, is_end: bool, file: &Scan) -> Result<(), MeshError> {
        if end < self.ends.last().copied().unwrap_or(0) {
            return Err(file.expected("offsets that ascend", &end.to_string()));
        }
        if is_end {
            self.ends.push(end);
        }
        Ok(())
    }

    /// Cells up to version 4: of each the number of its nodes, and the nodes.
    fn read_cells(&mut self, file: &mut Scan) -> Result<(), MeshError> {
        let count = file.text_index("the number of cells")?;
        file.text_index("the number of numbers")?;
        if file.coding != Coding::Words {
            file.end_text("the end of the line")?;
        }
        for _ in 0..count {
            for _ in 0..file.index(Kind::I32, "the number of nodes of a cell")? {
                let node = file.index(Kind::I32, "a node of a cell")?;
                self.nodes.push(node);
            }
            self.ends.push(self.nodes.len());
        }
        Ok(())
    }

    /// Passes the arrays of points and cells, of which one may have the regions.
    fn read_data(&mut self, file: &mut Scan, first: &str) -> Result<(), MeshError> {
        let mut of_cells = first == "CELL_DATA";
        let mut count = file.text_index("the number of cells or points")?;
        while let Some(word) = file.next_word() {
            let per_value = match word {
                "CELL_DATA" | "POINT_DATA" => {
                    of_cells = word == "CELL_DATA";
                    count = file.text_index("the number of cells or points")?;
                    continue;
                }
                "METADATA" => {
                    file.skip_paragraph();
                    continue;
                }
                "FIELD" => {
                    file.word("the name of a field")?;
                    for _ in 0..file.text_index("the number of arrays")? {
                        let name = file.word("the name of an array")?;
                        let width = file.text_index("numbers for each cell")?;
                        let tuples = file.text_index("the number of cells or points")?;
                        let kind = kind(file)?;
                        self.array(file, kind, of_cells, name, [tuples, width])?;
                        if let Some("METADATA") = file.clone().next_word() {
                            file.next_record();
                            file.skip_paragraph();
                        }
                    }
                    continue;
                }
                // As bytes these are bytes.
                "COLOR_SCALARS" | "LOOKUP_TABLE" => {
                    file.word("the name of an array")?;
                    let number = file.text_index("a number of values")?;
                    let is_table = word == "LOOKUP_TABLE";
                    let values = if is_table {
                        [number, 4]
                    } else {
                        [count, number]
                    };
                    file.next_line();
                    self.array(file, Kind::U8, false, "", values)?;
                    continue;
                }
                "SCALARS" | "GLOBAL_IDS" | "PEDIGREE_IDS" => 1,
                "VECTORS" | "NORMALS" => 3,
                "TENSORS" => 9,
                "TENSORS6" => 6,
                other => return Err(file.expected("the head of an array, such as SCALARS", other)),
            };
            let name = file.word("the name of an array")?;
            let kind = self.attribute(file, word == "SCALARS", per_value)?;
            self.array(file, kind.0, of_cells, name, [count, kind.1])?;
        }
        Ok(())
    }

    /// Type and width of an attribute; `SCALARS` may say the width, and name a table of colours.
    fn attribute(
        &self,
        file: &mut Scan,
        is_scalars: bool,
        width: u64,
    ) -> Result<(Kind, u64), MeshError> {
        if !is_scalars {
            return Ok((kind(file)?, width));
        }
        let what = "a type such as double, and how many numbers for each";
        let line = String::from_utf8_lossy(file.rest_of_line()).into_owned();
        let mut words = line.split_whitespace();
        let kind = words.next().and_then(kind_of);
        let width = words.next().map_or(Some(width), |word| word.parse().ok());
        let (Some(kind), Some(width)) = (kind, width) else {
            return Err(file.expected(what, &line));
        };
        file.next_line();
        file.keyword("LOOKUP_TABLE")?;
        file.next_line();
        Ok((kind, width))
    }

    /// Reads or passes the values of an array.
    fn array(
        &mut self,
        file: &mut Scan,
        kind: Kind,
        of_cells: bool,
        name: &str,
        [tuples, width]: [u64; 2],
    ) -> Result<(), MeshError> {
        let name = &decoded(name);
        let what = format!("the values of the array {name}");
        let head = Head {
            name,
            width,
            is_whole: !matches!(kind, Kind::F32 | Kind::F64),
        };
        let has_regions = of_cells && self.arrays.takes(head);
        if has_regions && tuples != self.kinds.len() as u64 {
            let cells = format!("a region for each of {} cells", self.kinds.len());
            return Err(file.expected(&cells, &tuples.to_string()));
        }
        let (mut regions, mut is_passed) = (Vec::new(), false);
        for _ in 0..tuples.saturating_mul(width) {
            if !has_regions {
                file.real(kind, &what)?;
                continue;
            }
            let number = file.number(kind, "a cell's region")?;
            match number.region() {
                Some(region) => regions.push(region),
                None if self.arrays.is_named() => {
                    return Err(file.no(number, "a cell's region, a whole number"));
                }
                // It has the name alone: a fraction in it makes no file a bad one.
                None => is_passed = true,
            }
        }
        match (has_regions, is_passed) {
            (true, true) => self.arrays.pass_over(),
            (true, false) => self.regions = regions,
            _ => {}
        }
        Ok(())
    }

    /// The tetrahedra of the grid.
    pub fn into_mesh(self, end: Place) -> Result<RawMesh, MeshError> {
        if self.kinds.len() != self.ends.len() {
            return Err(MeshError::Syntax {
                at: end,
                expected: format!("a type for each of {} cells", self.ends.len()),
                found: format!("{} types", self.kinds.len()),
            });
        }
        let mut gather = Gather::counted_from(0);
        gather.points = self.points;
        let mut start = 0;
        for (index, (&(kind, at), &end)) in self.kinds.iter().zip(&self.ends).enumerate() {
            let nodes = self.nodes.get(start..end).unwrap_or(&[]);
            start = end;
            let region = self.regions.get(index).copied().unwrap_or(0);
            let name = format!("{kind} of VTK");
            gather.cell(at, index as u64, (shape(kind), &name), region, nodes)?;
        }
        gather.notes = self.arrays.end()?;
        gather.into_mesh()
    }
}

/// A name as it was before it was written: legacy files have blanks and signs as `%20`.
fn decoded(name: &str) -> String {
    let mut bytes = Vec::with_capacity(name.len());
    let mut rest = name.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        let code = after.get(..2).filter(|_| first == b'%');
        let code = code.and_then(|two| std::str::from_utf8(two).ok());
        let byte = code.and_then(|two| u8::from_str_radix(two, 16).ok());
        bytes.push(byte.unwrap_or(first));
        rest = match byte {
            Some(_) => &after[2..],
            None => after,
        };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// What VTK's types of cells are.
fn shape(kind: u64) -> Shape {
    match kind {
        // Points, lines, polygons, and their curved kinds.
        0..=9 | 21..=23 | 28 | 30 | 34 | 35 | 68..=70 => Shape::Lower,
        10 => Shape::Tetrahedron,
        24 => Shape::Tetrahedron10,
        11 => Shape::Other("voxel"),
        12 => Shape::Other("8-node hexahedron"),
        13 => Shape::Other("6-node prism"),
        14 => Shape::Other("5-node pyramid"),
        42 => Shape::Other("polyhedron"),
        25..=27 | 29 | 31..=33 | 71..=81 => Shape::Other("volume cell of high order"),
        _ => Shape::Other("no type that is known here"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OLD: &str = "# vtk DataFile Version 3.0\n\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 double\n0 0 0 1 0 0\n0 1 0 0 0 1\n1 1 1\n\
        CELLS 3 14\n3 0 1 2\n4 0 1 2 3\n4 1 2 3 4\nCELL_TYPES 3\n5\n10\n10\n";
    const NEW: &str = "# vtk DataFile Version 5.1\ntitle\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n0 0 0 1 0 0 0 1 0\n0 0 1 1 1 1\n\nMETADATA\nINFORMATION 0\n\n\
        CELLS 4 11\nOFFSETS vtktypeint64\n0 3 7 11\nCONNECTIVITY vtktypeint64\n0 1 2 0 1 2 3\n1 2 3 4\nCELL_TYPES 3\n5\n10\n10\n";

    #[test]
    fn both_kinds_of_cells_are_read() {
        for text in [OLD, NEW] {
            let mesh = read_vtk(text.as_bytes(), None).expect("a sound mesh");
            assert_eq!(mesh.points_m[3], [0.0, 0.0, 1.0]);
            assert_eq!(
                mesh.cells,
                [[0, 1, 2, 3], [1, 2, 3, 4]],
                "the triangle is left out"
            );
            assert_eq!(mesh.regions, [0, 0]);
            assert!(mesh.check().is_ok());
        }
    }

    #[test]
    fn regions_are_found_in_scalars_and_fields() {
        let scalars = "CELL_DATA 3\nSCALARS pressure float 1\nLOOKUP_TABLE default\n1 nan 3\nSCALARS CellEntityIds int 1\nLOOKUP_TABLE default\n9\n7 8\n";
        let field = "POINT_DATA 5\nSCALARS region int\nLOOKUP_TABLE default\n1 1 1 1 1\nCELL_DATA 3\nFIELD FieldData 2\nid 1 3 int\n4 5 6\nregion 1 3 double\n9 7.0 8\n";
        for data in [scalars, field] {
            let mesh = read_vtk(format!("{OLD}{data}").as_bytes(), None).expect("a sound mesh");
            assert_eq!(mesh.regions, [7, 8]);
        }
    }

    #[test]
    fn arrays_are_taken_by_name_and_others_are_told() {
        let data = "CELL_DATA 3\nFIELD FieldData 3\nmy%20ids 1 3 int\n4 5 6\nlabels 1 3 int\n9 7 8\nregion 1 3 short\n1 2 3\n";
        let text = format!("{OLD}{data}");
        let regions = |name: Option<&str>| read_vtk(text.as_bytes(), name).map(|mesh| mesh.regions);
        assert_eq!(regions(None), Ok(vec![2, 3]));
        assert_eq!(regions(Some("labels")), Ok(vec![7, 8]));
        assert_eq!(regions(Some("my ids")), Ok(vec![5, 6]));
        let said = regions(Some("mat")).expect_err("no such array").to_string();
        assert!(
            said.contains("`mat`") && said.contains("my ids, labels, region"),
            "{said}"
        );
        let mesh = read_vtk(text.as_bytes(), None).expect("sound");
        let told = mesh.notes.join("\n");
        for name in ["--region my ids", "--region labels"] {
            assert!(told.contains(name), "{name}: {told}");
        }
    }

    /// A probability or a modulus under a name that regions have shuts no file out; a name that is given has to have regions.
    #[test]
    fn arrays_that_have_fractions_are_passed_over() {
        let array = |name: &str, values: &str| format!("{name} 1 3 float\n{values}\n");
        let (whole, half, none) = ("1 2 3", "0.5 0.7 1", "nan 2 3");
        for (arrays, regions, passed) in [
            (vec![array("tissue", half)], [0, 0], &["tissue"][..]),
            (vec![array("region", none)], [0, 0], &["region"]),
            (
                vec![array("tissue", half), array("labels", whole)],
                [2, 3],
                &["tissue"],
            ),
            (
                vec![array("labels", whole), array("Region", half)],
                [2, 3],
                &["Region"],
            ),
            (
                vec![
                    array("mat", none),
                    array("material", half),
                    array("labels", whole),
                ],
                [2, 3],
                &["mat", "material"],
            ),
        ] {
            let data = format!(
                "CELL_DATA 3\nFIELD FieldData {}\n{}",
                arrays.len(),
                arrays.concat()
            );
            let text = format!("{OLD}{data}");
            let mesh = read_vtk(text.as_bytes(), None).expect("a good file");
            assert_eq!(mesh.regions, regions, "{data}");
            for name in passed {
                let said = format!(
                    "`{name}` has the name of one of regions, and numbers that are not whole"
                );
                assert!(
                    mesh.notes.iter().any(|note| note.contains(&said)),
                    "{:?}",
                    mesh.notes
                );
                let error = read_vtk(text.as_bytes(), Some(name))
                    .expect_err("a fraction")
                    .to_string();
                assert!(error.contains("a cell's region, a whole number"), "{error}");
            }
        }
    }

    #[test]
    fn errors_name_the_line() {
        let refused = |text: &str, said: &[&str]| {
            let error = read_vtk(text.as_bytes(), None)
                .expect_err("a bad file")
                .to_string();
            for words in said {
                assert!(error.contains(words), "no {words} in: {error}");
            }
        };
        refused("solid\n", &["line 1", "# vtk DataFile Version"]);
        refused(&OLD.replace("ASCII", "UTF8"), &["line 3", "ASCII"]);
        refused(&OLD.replace("1 1 1\n", "1 x 1\n"), &["line 8", "`x`"]);
        refused(
            &OLD.replace("5\n10\n10\n", "5\n10\n12\n"),
            &["line 16", "type 12"],
        );
        refused(
            &OLD.replace("5\n10\n10\n", "5\n10\n"),
            &["line 16", "cut off"],
        );
        refused(
            &OLD.replace("4 1 2 3 4\n", "4 1 2 3 9\n"),
            &["node 9", "5 nodes"],
        );
        refused(&OLD.replace("UNSTRUCTURED_GRID", "POLYDATA"), &["line 4"]);
        refused(&NEW.replace("0 3 7 11", "0 7 3 11"), &["line 14", "ascend"]);
        let data = "CELL_DATA 3\nSCALARS region int\nLOOKUP_TABLE default\n1 2\n";
        refused(&format!("{OLD}{data}"), &["a cell's region", "cut off"]);
    }
}
