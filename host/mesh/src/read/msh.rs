//! Reads gmsh `.msh` files, 2.2 and 4.1, as text and binary: nodes and tetrahedra, the rest is left out.
//!
//! Entry point: [`read_msh`]. Format: Gmsh reference manual, chapter "MSH file format". Both codings have the same
//! numbers in the same order, but for the elements of 2.2.

use super::super::{MeshError, RawMesh, TetMesh};
use super::gather::{Gather, Shape};
use super::scan::{Coding, Endian, Kind, Scan};
use std::collections::{BTreeMap, HashMap};

/// gmsh's dimension of a volume.
const VOLUME: u64 = 3;

/// What gmsh writes as `int` and as `size_t`; coordinates are doubles.
const INT: Kind = Kind::I32;
const SIZE: Kind = Kind::U64;

/// Reads a mesh and scales its coordinates by `scale_to_m` into metres. Node k of the result is the
/// k-th node of the file, whatever its tag.
///
/// # Errors
/// A [`MeshError`] with the line, or in a binary file the byte, for what cannot be read, with the element's or
/// node's tag for a mesh that fails a check. Nodes without a tetrahedron are refused.
///
/// ```
/// let text = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n\
///     $Nodes\n4\n1 0 0 0\n2 10 0 0\n3 0 10 0\n4 0 0 10\n$EndNodes\n\
///     $Elements\n1\n1 4 2 0 1 1 2 3 4\n$EndElements\n";
/// let mesh = sutura_mesh::read_msh(text, 1e-3)?;
/// assert_eq!(mesh.points_m()[1], [0.01, 0.0, 0.0]);
/// # Ok::<(), sutura_mesh::MeshError>(())
/// ```
pub fn read_msh<B: AsRef<[u8]> + ?Sized>(file: &B, scale_to_m: f64) -> Result<TetMesh, MeshError> {
    read_msh_raw(file)?.scaled(scale_to_m)?.check()
}

/// Reads a file without a look at the mesh in it, in the file's own unit of length. A cell's region is
/// its physical group; of several the first.
///
/// # Errors
/// A [`MeshError`] with the line or byte of what cannot be read.
pub fn read_msh_raw<B: AsRef<[u8]> + ?Sized>(file: &B) -> Result<RawMesh, MeshError> {
    let mut scan = Scan::new(file.as_ref(), Coding::Lines, None);
    scan.record("$MeshFormat")?;
    let head = scan.word("$MeshFormat")?;
    if head != "$MeshFormat" {
        let what = "$MeshFormat as the first section of a gmsh file";
        return Err(scan.expected(what, head));
    }
    let version = read_format(&mut scan)?;
    let mut file = File::default();
    while scan.next_record() {
        let name = scan.word("a section")?;
        let Some(section) = name.strip_prefix('$') else {
            return Err(scan.expected("a section such as $Nodes", name));
        };
        let is_second = match section {
            "Nodes" => std::mem::replace(&mut file.nodes_read, true),
            "Elements" => std::mem::replace(&mut file.elements_read, true),
            _ => false,
        };
        if is_second {
            return Err(MeshError::SecondSection {
                at: scan.place(),
                section: if section == "Nodes" {
                    "$Nodes"
                } else {
                    "$Elements"
                },
            });
        }
        let end = format!("$End{section}");
        // The line ends before numbers as bytes begin.
        scan.next_line();
        match (section, version) {
            ("Nodes", Version::V22) => file.nodes_22(&mut scan)?,
            ("Nodes", Version::V41) => file.nodes_41(&mut scan)?,
            ("Elements", Version::V22) if scan.coding == Coding::Lines => {
                file.elements_22(&mut scan)?;
            }
            ("Elements", Version::V22) => file.elements_22_binary(&mut scan)?,
            ("Elements", Version::V41) => file.elements_41(&mut scan)?,
            ("PhysicalNames", _) => file.physical_names(&mut scan)?,
            ("Entities", Version::V41) => file.entities(&mut scan, false)?,
            ("PartitionedEntities", Version::V41) => file.entities(&mut scan, true)?,
            _ => {
                if !scan.skip_to(&end) {
                    return Err(scan.cut_off(&end));
                }
                continue;
            }
        }
        scan.keyword(&end)?;
    }
    file.into_mesh()
}

#[derive(Clone, Copy)]
enum Version {
    V22,
    V41,
}

fn read_format(scan: &mut Scan) -> Result<Version, MeshError> {
    scan.next_line();
    scan.record("the format's version")?;
    let at = scan.place();
    let line = scan.rest_of_line();
    let found = String::from_utf8_lossy(line).into_owned();
    let words: Vec<&str> = found.split_whitespace().collect();
    let refuse = |found: String| Err(MeshError::Version { at, found });
    let (version, is_binary) = match words[..] {
        [version @ ("2.2" | "4.1"), coding @ ("0" | "1"), "8"] => (version, coding == "1"),
        ["2.2" | "4.1", "0" | "1", size] => return refuse(format!("numbers of {size} bytes")),
        ["2.2" | "4.1", coding, _] => {
            let what = "a coding of 0 for text, 1 for bytes";
            return Err(scan.expected(what, coding));
        }
        _ => return refuse(format!("gmsh format {found}")),
    };
    let version = match version {
        "2.2" => Version::V22,
        _ => Version::V41,
    };
    scan.next_line();
    if is_binary {
        scan.coding = Coding::Binary(Endian::Little);
        let what = "the number 1 in four bytes";
        scan.coding = match scan.take(4, what)? {
            [1, 0, 0, 0] => Coding::Binary(Endian::Little),
            [0, 0, 0, 1] => Coding::Binary(Endian::Big),
            other => return Err(scan.expected(what, &format!("{other:?}"))),
        };
    }
    scan.keyword("$EndMeshFormat")?;
    Ok(version)
}

/// What has been read so far.
struct File {
    mesh: Gather,
    /// Names of physical groups, by dimension and number.
    names: BTreeMap<i64, String>,
    /// Physical group of each volume of the geometry (4.1).
    group_of: HashMap<i64, i64>,
    nodes_read: bool,
    elements_read: bool,
}

impl Default for File {
    fn default() -> Self {
        Self {
            mesh: Gather::numbered(),
            names: BTreeMap::new(),
            group_of: HashMap::new(),
            nodes_read: false,
            elements_read: false,
        }
    }
}

impl File {
    /// These are text in binary files too.
    fn physical_names(&mut self, scan: &mut Scan) -> Result<(), MeshError> {
        let what = "a physical group: dimension number \"name\"";
        let count = text_count(scan, "the number of names")?;
        let coding = std::mem::replace(&mut scan.coding, Coding::Lines);
        for _ in 0..count {
            scan.record(what)?;
            let dimension = scan.index(INT, what)?;
            let number = scan.region(INT, what)?;
            let name = String::from_utf8_lossy(scan.rest_of_line());
            if name.is_empty() {
                return Err(scan.expected(what, "the end of the line"));
            }
            if dimension == VOLUME {
                self.names.insert(number, name.trim_matches('"').to_owned());
            }
        }
        scan.coding = coding;
        Ok(())
    }

    /// Parts of the geometry, and in a mesh that is cut into partitions what becomes of them there, of each: its number, in a
    /// partition its parent and the partitions, its place or six bounds, how many groups, the groups, what bounds it.
    fn entities(&mut self, scan: &mut Scan, is_partitioned: bool) -> Result<(), MeshError> {
        if is_partitioned {
            let what = "the number of partitions";
            scan.record(what)?;
            scan.index(SIZE, what)?;
            scan.end_record(what)?;
            let what = "the number of ghost entities, then of each its number and its partition";
            scan.record(what)?;
            let ghosts = scan.index(SIZE, what)?;
            scan.end_record(what)?;
            for _ in 0..ghosts {
                scan.record(what)?;
                scan.region(INT, what)?;
                scan.region(INT, what)?;
                scan.end_record(what)?;
            }
        }
        let what = "numbers of points, curves, surfaces, volumes";
        scan.record(what)?;
        let mut counts = [0; 4];
        for count in &mut counts {
            *count = scan.index(SIZE, what)?;
        }
        scan.end_record(what)?;
        for (dimension, count) in (0..).zip(counts) {
            for _ in 0..count {
                self.entity(scan, dimension, is_partitioned)?;
            }
        }
        Ok(())
    }

    /// One of them. A part of a partition has its parent's group where it has none of its own.
    fn entity(
        &mut self,
        scan: &mut Scan,
        dimension: u64,
        is_partitioned: bool,
    ) -> Result<(), MeshError> {
        let what = match is_partitioned {
            true => {
                "a part of a partition: number, parent, partitions, bounds, number of physical groups, the groups, what bounds it"
            }
            false => {
                "a part of the geometry: number, bounds, number of physical groups, the groups, what bounds it"
            }
        };
        scan.record(what)?;
        let number = scan.region(INT, what)?;
        let mut group = None;
        if is_partitioned {
            let parent_dimension = scan.region(INT, what)?;
            let parent = scan.region(INT, what)?;
            if parent_dimension == VOLUME as i64 {
                group = self.group_of.get(&parent).copied();
            }
            for _ in 0..scan.index(SIZE, what)? {
                scan.region(INT, what)?;
            }
        }
        for _ in 0..if dimension == 0 { 3 } else { 6 } {
            scan.real(Kind::F64, what)?;
        }
        for index in 0..scan.index(SIZE, what)? {
            let physical = scan.region(INT, what)?;
            if index == 0 {
                group = Some(physical);
            }
        }
        if let (VOLUME, Some(group)) = (dimension, group) {
            self.group_of.insert(number, group);
        }
        if dimension > 0 {
            for _ in 0..scan.index(SIZE, what)? {
                scan.region(INT, what)?;
            }
        }
        scan.end_record(what)
    }

    fn nodes_22(&mut self, scan: &mut Scan) -> Result<(), MeshError> {
        let what = "a node: number x y z";
        let count = text_count(scan, "the number of nodes")?;
        for _ in 0..count {
            scan.record(what)?;
            let place = scan.place();
            let tag = scan.index(INT, what)?;
            let at = scan.point(Kind::F64)?;
            scan.end_record(what)?;
            self.mesh.node(place, tag, at)?;
        }
        Ok(())
    }

    fn nodes_41(&mut self, scan: &mut Scan) -> Result<(), MeshError> {
        let [blocks, count, ..] = head(scan, "nodes")?;
        let mut block_tags = Vec::new();
        for _ in 0..blocks {
            let (dimension, _, parametric, in_block) =
                block(scan, "a block of nodes: dimension tag parametric count")?;
            block_tags.clear();
            for _ in 0..in_block {
                scan.record("a node's number")?;
                block_tags.push(scan.index(SIZE, "a node's number")?);
                scan.end_record("a node's number")?;
            }
            for &tag in &block_tags {
                scan.record("a node's coordinates")?;
                let place = scan.place();
                let at = scan.point(Kind::F64)?;
                for _ in 0..if parametric == 0 { 0 } else { dimension } {
                    scan.real(Kind::F64, "a node's place on the geometry")?;
                }
                scan.end_record("three coordinates")?;
                self.mesh.node(place, tag, at)?;
            }
        }
        let found = self.mesh.points.len();
        if found as u64 != count {
            let found = format!("{found} nodes in the blocks");
            return Err(scan.expected(&format!("{count} nodes as announced"), &found));
        }
        Ok(())
    }

    fn elements_22(&mut self, scan: &mut Scan) -> Result<(), MeshError> {
        let what = "an element: number type tag-count tags nodes";
        let count = text_count(scan, "the number of elements")?;
        let mut nodes = Vec::new();
        for _ in 0..count {
            scan.record(what)?;
            let tag = scan.index(INT, what)?;
            let kind = scan.index(INT, what)?;
            let mut region = 0;
            for label in 0..scan.index(INT, what)? {
                let number = scan.region(INT, what)?;
                if label == 0 {
                    region = number;
                }
            }
            self.element(scan, (tag, kind), region, &mut nodes, INT)?;
        }
        Ok(())
    }

    /// Blocks of a type, a count and how many tags each has; then elements without either.
    fn elements_22_binary(&mut self, scan: &mut Scan) -> Result<(), MeshError> {
        let what = "a block of elements: type count tag-count";
        let count = text_count(scan, "the number of elements")?;
        let (mut seen, mut nodes) = (0u64, Vec::new());
        while seen < count {
            let kind = scan.index(INT, what)?;
            let in_block = scan.index(INT, what)?;
            let labels = scan.index(INT, what)?;
            for _ in 0..in_block {
                let tag = scan.index(INT, "an element's number")?;
                let mut region = 0;
                for label in 0..labels {
                    let number = scan.region(INT, "an element's tag")?;
                    if label == 0 {
                        region = number;
                    }
                }
                self.element(scan, (tag, kind), region, &mut nodes, INT)?;
            }
            seen = seen.saturating_add(in_block);
        }
        if seen == count {
            return Ok(());
        }
        let found = format!("{seen} elements in the blocks");
        Err(scan.expected(&format!("{count} elements as announced"), &found))
    }

    fn elements_41(&mut self, scan: &mut Scan) -> Result<(), MeshError> {
        let [blocks, count, ..] = head(scan, "elements")?;
        let (mut seen, mut nodes) = (0u64, Vec::new());
        for _ in 0..blocks {
            let (dimension, entity, kind, in_block) =
                block(scan, "a block of elements: dimension tag type count")?;
            let region = match dimension {
                VOLUME => self.group_of.get(&entity).copied().unwrap_or(0),
                _ => 0,
            };
            for _ in 0..in_block {
                scan.record("an element: number nodes")?;
                let tag = scan.index(SIZE, "an element: number nodes")?;
                self.element(scan, (tag, kind), region, &mut nodes, SIZE)?;
            }
            seen = seen.saturating_add(in_block);
        }
        if seen == count {
            return Ok(());
        }
        let found = format!("{seen} elements in the blocks");
        Err(scan.expected(&format!("{count} elements as announced"), &found))
    }

    /// The nodes of an element; `nodes` is room for them.
    fn element(
        &mut self,
        scan: &mut Scan,
        (tag, kind): (u64, u64),
        region: i64,
        nodes: &mut Vec<u64>,
        number: Kind,
    ) -> Result<(), MeshError> {
        let place = scan.place();
        let shape = shape(kind);
        nodes.clear();
        if !matches!(shape, Shape::Other(_)) {
            let what = match shape {
                Shape::Tetrahedron => "four nodes of a tetrahedron",
                _ => "the nodes of an element",
            };
            let count = nodes_of(kind).unwrap_or(0);
            for _ in 0..count {
                nodes.push(scan.index(number, what)?);
            }
            scan.end_record(what)?;
        }
        let name = format!("{kind} of gmsh");
        self.mesh.cell(place, tag, (shape, &name), region, nodes)
    }

    fn into_mesh(mut self) -> Result<RawMesh, MeshError> {
        if !self.nodes_read {
            return Err(MeshError::NoSection("$Nodes"));
        }
        if !self.elements_read {
            return Err(MeshError::NoSection("$Elements"));
        }
        self.mesh.region_names = self.names;
        self.mesh.into_mesh()
    }
}

/// A count in a line of its own, in binary files of 2.2 too.
fn text_count(scan: &mut Scan, what: &str) -> Result<u64, MeshError> {
    let count = scan.text_index(what)?;
    scan.end_text(what)?;
    Ok(count)
}

/// The head of a section of 4.1.
fn head(scan: &mut Scan, of: &str) -> Result<[u64; 4], MeshError> {
    let what = format!("number of blocks, number of {of}, smallest and largest tag");
    scan.record(&what)?;
    let mut head = [0; 4];
    for number in &mut head {
        *number = scan.index(SIZE, &what)?;
    }
    scan.end_record(&what)?;
    Ok(head)
}

/// The head of a block: dimension, the entity's tag, which may be negative, a type or flag, a count.
fn block(scan: &mut Scan, what: &str) -> Result<(u64, i64, u64, u64), MeshError> {
    scan.record(what)?;
    let dimension = scan.index(INT, what)?;
    let entity = scan.region(INT, what)?;
    let third = scan.index(INT, what)?;
    let count = scan.index(SIZE, what)?;
    scan.end_record(what)?;
    Ok((dimension, entity, third, count))
}

/// What one of gmsh's types of elements is.
fn shape(kind: u64) -> Shape {
    match kind {
        4 => Shape::Tetrahedron,
        11 => Shape::Tetrahedron10,
        5 => Shape::Other("8-node hexahedron"),
        6 => Shape::Other("6-node prism"),
        7 => Shape::Other("5-node pyramid"),
        12..=14 | 17..=19 => Shape::Other("second-order volume element"),
        29..=33 | 71..=75 | 79..=83 | 90..=93 => Shape::Other("high-order volume element"),
        _ if nodes_of(kind).is_some() => Shape::Lower,
        _ => Shape::Other("no type that is known here"),
    }
}

/// How many nodes a point, line, face or tetrahedron of a type has.
fn nodes_of(kind: u64) -> Option<usize> {
    Some(match kind {
        15 => 1,
        1 => 2,
        2 | 8 => 3,
        3 | 4 | 26 => 4,
        27 => 5,
        9 | 28 => 6,
        62 => 7,
        16 | 63 => 8,
        10 | 20 | 64 => 9,
        11 | 21 | 65 => 10,
        66 => 11,
        22 | 39 => 12,
        23 | 24 => 15,
        36 | 40 => 16,
        52 => 18,
        41 => 20,
        25 | 53 => 21,
        37 => 25,
        42 => 28,
        43 | 38 => 36,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Place;

    const HEAD_22: &str = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n";
    const NODES_22: &str =
        "$Nodes\n5\n10 0 0 0\n20 1 0 0\n30 0 1 0\n40 0 0 1\n50 1 1 1\n$EndNodes\n";
    const ELEMENTS_22: &str =
        "$Elements\n3\n1 15 2 0 1 10\n7 4 2 0 1 10 20 30 40\n8 4 2 0 1 20 30 40 50\n$EndElements\n";
    const FILE_41: &str = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Entities\n0 0 0 1\n\
        1 0 0 0 1 1 1 0 0\n$EndEntities\n\
        $Nodes\n2 5 10 50\n2 1 0 2\n50\n10\n1 1 1\n0 0 0\n3 -1 0 3\n20\n30\n40\n1 0 0\n0 1 0\n0 0 1\n$EndNodes\n\
        $Elements\n2 3 1 8\n2 1 2 1\n1 10 20 30\n3 1 4 2\n7 10 20 30 40\n8 20 30 40 50\n$EndElements\n";

    fn message(text: &str) -> String {
        read_msh(text, 1.0).expect_err("a bad file").to_string()
    }

    #[test]
    fn both_versions_give_the_nodes_in_file_order() {
        let old = read_msh(&format!("{HEAD_22}{NODES_22}{ELEMENTS_22}"), 1.0).expect("2.2");
        assert_eq!(old.cells(), [[0, 1, 2, 3], [1, 2, 3, 4]]);
        let new = read_msh(FILE_41, 1e-3).expect("4.1");
        assert_eq!(
            new.points_m()[0],
            [1e-3, 1e-3, 1e-3],
            "node 50 comes first in this file"
        );
        assert_eq!(new.cells(), [[1, 2, 3, 4], [2, 3, 4, 0]]);
    }

    #[test]
    fn physical_groups_are_the_regions() {
        let names = "$PhysicalNames\n2\n2 3 \"skin\"\n3 3 \"fat layer\"\n$EndPhysicalNames\n";
        let old = ELEMENTS_22.replace("8 4 2 0 1", "8 4 2 3 1");
        let old = read_msh(&format!("{HEAD_22}{names}{NODES_22}{old}"), 1.0).expect("2.2");
        assert_eq!(old.regions(), [0, 3]);
        assert_eq!(old.region_names()[&3], "fat layer");
        let new = FILE_41.replace("1 0 0 0 1 1 1 0 0\n", "1 0 0 0 1 1 1 2 5 6 0\n");
        let new = read_msh(&new, 1.0).expect("4.1");
        assert_eq!(new.regions(), [5, 5], "of two groups the first");
    }

    /// A box that gmsh cuts into two partitions: its volume 1 becomes 2 and 3, the one with a group of its own.
    #[test]
    fn parts_of_partitions_have_their_parents_groups() {
        let entities = "1 0 0 0 1 1 1 1 7 0\n";
        let partitions = "$EndEntities\n$PartitionedEntities\n2\n1\n9 2\n1 1 0 2\n\
            4 0 1 1 2 0 0 0 0\n5 1 1 1 2 0 0 0 1 0 0 0 2 4 -4\n\
            2 3 1 1 1 0 0 0 1 1 1 0 1 3\n3 3 1 2 1 2 0 0 0 1 1 1 1 8 0\n\
            $EndPartitionedEntities\n";
        let elements =
            "$Elements\n2 2 7 8\n3 2 4 1\n7 10 20 30 40\n3 3 4 1\n8 20 30 40 50\n$EndElements\n";
        let file = FILE_41
            .replace("1 0 0 0 1 1 1 0 0\n", entities)
            .replace("$EndEntities\n", partitions);
        let (head, _) = file.split_once("$Elements").expect("a section");
        let mesh = read_msh(&format!("{head}{elements}"), 1.0).expect("partitioned");
        assert_eq!(mesh.regions(), [7, 8]);
    }

    #[test]
    fn a_file_cut_anywhere_is_refused_with_a_line() {
        let lines: Vec<&str> = FILE_41.lines().collect();
        for kept in 0..lines.len() {
            let text = lines[..kept].join("\n");
            let error = read_msh(&text, 1.0).expect_err("a part of a file");
            assert!(
                matches!(error, MeshError::Truncated { at, .. } if at == Place::Line(kept + 1))
                    || matches!(error, MeshError::NoSection(_)),
                "{kept} lines: {error}"
            );
        }
    }

    #[test]
    fn versions_and_encodings_are_named() {
        for (head, name) in [
            ("4.0 0 8", "gmsh format 4.0"),
            ("1.0 0 8", "1.0"),
            ("4.1 1 4", "numbers of 4 bytes"),
        ] {
            let text = message(&format!("$MeshFormat\n{head}\n$EndMeshFormat\n"));
            assert!(text.contains("line 2") && text.contains(name), "{text}");
        }
        assert!(message("solid thing\nfacet\n").contains("$MeshFormat"));
    }

    #[test]
    fn errors_carry_the_files_own_numbers() {
        let inverted = ELEMENTS_22.replace("20 30 40 50", "30 20 40 50");
        let text = message(&format!("{HEAD_22}{NODES_22}{inverted}"));
        assert!(text.contains("element 8 (index 1) is inverted"), "{text}");

        let missing = ELEMENTS_22.replace("20 30 40 50", "20 30 40 51");
        let text = message(&format!("{HEAD_22}{NODES_22}{missing}"));
        assert!(text.contains("element 8 (index 1) names node 51"), "{text}");

        let unused = ELEMENTS_22
            .replace("3\n1 15", "2\n1 15")
            .replace("8 4 2 0 1 20 30 40 50\n", "");
        let text = message(&format!("{HEAD_22}{NODES_22}{unused}"));
        assert!(
            text.contains("node 50 (index 4) belongs to no tetrahedron"),
            "{text}"
        );

        let twice = ELEMENTS_22.replace("20 30 40 50", "40 30 20 10");
        let text = message(&format!("{HEAD_22}{NODES_22}{twice}"));
        assert!(text.contains("element 8"), "{text}");

        let infinite = NODES_22.replace("40 0 0 1", "40 0 0 1e999");
        let text = message(&format!("{HEAD_22}{infinite}{ELEMENTS_22}"));
        assert!(
            text.contains("node 40 (index 3)") && text.contains("finite"),
            "{text}"
        );
    }

    #[test]
    fn wrong_counts_words_and_types_point_at_the_line() {
        let text = message(&format!(
            "{HEAD_22}{}",
            NODES_22.replace("$Nodes\n5", "$Nodes\n6")
        ));
        assert!(text.contains("line 11"), "{text}");
        let text = message(&format!(
            "{HEAD_22}{}",
            NODES_22.replace("20 1 0 0", "20 1 zero 0")
        ));
        assert!(
            text.contains("line 7") && text.contains("20 1 zero 0"),
            "{text}"
        );
        let text = message(&FILE_41.replace("2 5 10 50", "2 6 10 50"));
        assert!(text.contains("6 nodes as announced"), "{text}");
        let text = message(&FILE_41.replace("3 1 4 2\n7 10 20 30 40", "3 1 5 2\n7 10 20 30 40"));
        assert!(
            text.contains("element 7") && text.contains("hexahedron"),
            "{text}"
        );
        let text = message(&format!("{HEAD_22}{NODES_22}{NODES_22}{ELEMENTS_22}"));
        assert!(text.contains("second $Nodes"), "{text}");
        let text = message(&format!(
            "{HEAD_22}{}",
            NODES_22.replace("20 1 0 0", "10 1 0 0")
        ));
        assert!(text.contains("node 10 is given twice"), "{text}");
        assert!(message(HEAD_22).contains("$Nodes"));
        assert!(matches!(read_msh(FILE_41, 0.0), Err(MeshError::Scale(_))));
    }

    #[test]
    fn a_huge_announced_count_asks_for_no_memory() {
        let text = FILE_41.replace("2 5 10 50", "2 18446744073709551615 10 50");
        assert!(read_msh(&text, 1.0).is_err());
        let text = format!("{HEAD_22}$Nodes\n18446744073709551615\n1 0 0 0\n");
        assert!(matches!(
            read_msh(&text, 1.0),
            Err(MeshError::Truncated { .. })
        ));
    }
}
