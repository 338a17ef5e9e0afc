//! Reads gmsh `.msh` files, 2.2 and 4.1 ASCII: nodes and four-node tetrahedra, the rest is skipped.
//!
//! Entry point: [`read_msh`]. Format: Gmsh reference manual, chapter "MSH file format".

use super::check::Tags;
use super::lines::Lines;
use super::{CellId, MeshError, RawMesh, TetMesh};
use std::collections::{BTreeMap, HashMap};

/// gmsh's number for a four-node tetrahedron.
const TETRAHEDRON: u64 = 4;

/// gmsh's dimension of a volume.
const VOLUME: u64 = 3;

/// Reads a mesh and scales its coordinates by `scale_to_m` into metres. Node k of the result is the
/// k-th node of the file, whatever its tag.
///
/// # Errors
/// A [`MeshError`] with the line for what cannot be read, with the element's or node's tag for a
/// mesh that fails a check. Nodes without a tetrahedron are refused.
///
/// ```
/// let text = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n\
///     $Nodes\n4\n1 0 0 0\n2 10 0 0\n3 0 10 0\n4 0 0 10\n$EndNodes\n\
///     $Elements\n1\n1 4 2 0 1 1 2 3 4\n$EndElements\n";
/// let mesh = sutura_mesh::read_msh(text, 1e-3)?;
/// assert_eq!(mesh.points_m()[1], [0.01, 0.0, 0.0]);
/// # Ok::<(), sutura_mesh::MeshError>(())
/// ```
pub fn read_msh(text: &str, scale_to_m: f64) -> Result<TetMesh, MeshError> {
    read_msh_raw(text)?.scaled(scale_to_m)?.check()
}

/// Reads a file without a look at the mesh in it, in the file's own unit of length. A cell's region is
/// its physical group; of several the first.
///
/// # Errors
/// A [`MeshError`] with the line for what cannot be read.
pub fn read_msh_raw(text: &str) -> Result<RawMesh, MeshError> {
    let mut file = File::default();
    let mut lines = Lines::new(text);
    let mut version = None;
    while let Some(line) = lines.next_filled() {
        match (line, version) {
            ("$MeshFormat", None) => version = Some(read_format(&mut lines)?),
            (_, None) => {
                return Err(lines.expected("$MeshFormat as the first section of a gmsh file", line));
            }
            ("$Nodes", Some(_)) if file.nodes_read => {
                return Err(MeshError::SecondSection {
                    line: lines.number,
                    section: "Nodes",
                });
            }
            ("$Elements", Some(_)) if file.elements_read => {
                return Err(MeshError::SecondSection {
                    line: lines.number,
                    section: "Elements",
                });
            }
            ("$Nodes", Some(Version::V22)) => file.nodes_22(&mut lines)?,
            ("$Nodes", Some(Version::V41)) => file.nodes_41(&mut lines)?,
            ("$Elements", Some(Version::V22)) => file.elements_22(&mut lines)?,
            ("$Elements", Some(Version::V41)) => file.elements_41(&mut lines)?,
            ("$PhysicalNames", Some(_)) => file.physical_names(&mut lines)?,
            ("$Entities", Some(Version::V41)) => file.entities(&mut lines)?,
            (other, Some(_)) => match other.strip_prefix('$') {
                Some(name) => lines.skip_to(&format!("$End{name}"))?,
                None => return Err(lines.expected("a section such as $Nodes", other)),
            },
        }
    }
    file.into_mesh()
}

#[derive(Clone, Copy)]
enum Version {
    V22,
    V41,
}

fn read_format(lines: &mut Lines) -> Result<Version, MeshError> {
    let line = lines.next("the format's version")?;
    let number = lines.number;
    let refuse = |found: String| MeshError::Version {
        line: number,
        found,
    };
    let mut words = line.split_whitespace();
    let version = match words.next() {
        Some("2.2") => Version::V22,
        Some("4.1") => Version::V41,
        other => {
            return Err(refuse(format!(
                "gmsh format {}",
                other.unwrap_or("without a version")
            )));
        }
    };
    if words.next() != Some("0") {
        return Err(refuse("a binary gmsh file".into()));
    }
    lines.end("$EndMeshFormat")?;
    Ok(version)
}

/// What has been read so far. Cells hold node tags until all nodes are known.
#[derive(Default)]
struct File {
    points: Vec<[f64; 3]>,
    tags: Tags,
    index_of: HashMap<u64, u32>,
    cells: Vec<[u64; 4]>,
    regions: Vec<i64>,
    region_names: BTreeMap<i64, String>,
    /// Physical group of each volume of the geometry (4.1).
    group_of: HashMap<i64, i64>,
    nodes_read: bool,
    elements_read: bool,
}

impl File {
    fn physical_names(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let what = "a physical group: dimension number \"name\"";
        let [count] = lines.integers("the number of names")?;
        for _ in 0..count {
            let line = lines.next(what)?;
            let mut words = line.splitn(3, char::is_whitespace);
            let dimension = lines.integer(words.next(), line, what)?;
            let number = lines.region(words.next().unwrap_or(""), line)?;
            let name = words.next().map(|name| name.trim().trim_matches('"'));
            let name = name.ok_or_else(|| lines.expected(what, line))?;
            if dimension == VOLUME {
                self.region_names.insert(number, name.to_owned());
            }
        }
        lines.end("$EndPhysicalNames")
    }

    /// Of a volume's line: its number, six bounds, how many groups, the groups, what bounds it.
    fn entities(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let [points, curves, surfaces, volumes] =
            lines.integers("numbers of points, curves, surfaces, volumes")?;
        for _ in 0..points.saturating_add(curves).saturating_add(surfaces) {
            lines.next("a point, curve or surface of the geometry")?;
        }
        let what = "a volume: number, six bounds, number of physical groups, the groups";
        for _ in 0..volumes {
            let line = lines.next(what)?;
            let mut words = line.split_whitespace();
            let volume = lines.region(words.next().unwrap_or(""), line)?;
            let groups = lines.integer(words.nth(6), line, what)?;
            if groups > 0 {
                let group = lines.region(words.next().unwrap_or(""), line)?;
                self.group_of.insert(volume, group);
            }
        }
        lines.end("$EndEntities")
    }

    fn nodes_22(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let [count] = lines.integers("the number of nodes")?;
        for _ in 0..count {
            let line = lines.next("a node: number x y z")?;
            let mut words = line.split_whitespace();
            let tag = lines.integer(words.next(), line, "a node: number x y z")?;
            let at = lines.point(&mut words, line)?;
            self.add_node(lines, tag, at)?;
        }
        self.nodes_read = true;
        lines.end("$EndNodes")
    }

    fn nodes_41(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let [blocks, count, ..] =
            lines.integers::<4>("number of blocks, number of nodes, smallest and largest tag")?;
        let mut block_tags = Vec::new();
        for _ in 0..blocks {
            let (_, [_, _, in_block]) =
                lines.block("a block of nodes: dimension tag parametric count")?;
            block_tags.clear();
            for _ in 0..in_block {
                let [tag] = lines.integers("a node's number")?;
                block_tags.push(tag);
            }
            for &tag in &block_tags {
                let line = lines.next("a node's coordinates")?;
                let at = lines.point(&mut line.split_whitespace(), line)?;
                self.add_node(lines, tag, at)?;
            }
        }
        if self.points.len() as u64 != count {
            let found = format!("{} nodes in the blocks", self.points.len());
            return Err(lines.expected(&format!("{count} nodes as announced"), &found));
        }
        self.nodes_read = true;
        lines.end("$EndNodes")
    }

    fn elements_22(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let [count] = lines.integers("the number of elements")?;
        let what = "an element: number type tag-count tags nodes";
        for _ in 0..count {
            let line = lines.next(what)?;
            let mut words = line.split_whitespace();
            let tag = lines.integer(words.next(), line, what)?;
            let kind = lines.integer(words.next(), line, what)?;
            let labels = lines.integer(words.next(), line, what)?;
            let mut region = 0;
            for label in 0..labels {
                let word = words.next().ok_or_else(|| lines.expected(what, line))?;
                if label == 0 {
                    region = lines.region(word, line)?;
                }
            }
            self.add_element(lines, [tag, kind], region, &mut words, line)?;
        }
        self.elements_read = true;
        lines.end("$EndElements")
    }

    fn elements_41(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let [blocks, count, ..] = lines
            .integers::<4>("number of blocks, number of elements, smallest and largest tag")?;
        let mut seen = 0;
        for _ in 0..blocks {
            let (entity, [dimension, kind, in_block]) =
                lines.block("a block of elements: dimension tag type count")?;
            let region = match dimension {
                VOLUME => self.group_of.get(&entity).copied().unwrap_or(0),
                _ => 0,
            };
            for _ in 0..in_block {
                let line = lines.next("an element: number nodes")?;
                let mut words = line.split_whitespace();
                let tag = lines.integer(words.next(), line, "an element: number nodes")?;
                self.add_element(lines, [tag, kind], region, &mut words, line)?;
            }
            seen += in_block;
        }
        if seen != count {
            let found = format!("{seen} elements in the blocks");
            return Err(lines.expected(&format!("{count} elements as announced"), &found));
        }
        self.elements_read = true;
        lines.end("$EndElements")
    }

    fn add_node(&mut self, lines: &Lines, tag: u64, at: [f64; 3]) -> Result<(), MeshError> {
        let index = u32::try_from(self.points.len())
            .map_err(|_| MeshError::TooManyNodes(self.points.len()))?;
        if self.index_of.insert(tag, index).is_some() {
            return Err(MeshError::NodeTagTwice {
                line: lines.number,
                tag,
            });
        }
        self.points.push(at);
        self.tags.nodes.push(tag);
        Ok(())
    }

    fn add_element<'a>(
        &mut self,
        lines: &Lines,
        [tag, kind]: [u64; 2],
        region: i64,
        words: &mut impl Iterator<Item = &'a str>,
        line: &str,
    ) -> Result<(), MeshError> {
        if kind != TETRAHEDRON {
            return match volume_type(kind) {
                Some(name) => Err(MeshError::ElementType {
                    line: lines.number,
                    tag,
                    kind,
                    name,
                }),
                None => Ok(()), // a point, line or face: it bounds a volume that others fill
            };
        }
        let mut cell = [0; 4];
        for node in &mut cell {
            *node = lines.integer(words.next(), line, "four nodes of a tetrahedron")?;
        }
        if words.next().is_some() {
            return Err(lines.expected("four nodes of a tetrahedron", line));
        }
        self.cells.push(cell);
        self.regions.push(region);
        self.tags.cells.push(tag);
        Ok(())
    }

    fn into_mesh(self) -> Result<RawMesh, MeshError> {
        if !self.nodes_read {
            return Err(MeshError::NoSection("Nodes"));
        }
        if !self.elements_read {
            return Err(MeshError::NoSection("Elements"));
        }
        let mut cells = Vec::with_capacity(self.cells.len());
        for (index, &cell) in self.cells.iter().enumerate() {
            let mut nodes = [0; 4];
            for (node, tag) in nodes.iter_mut().zip(cell) {
                *node = *self.index_of.get(&tag).ok_or(MeshError::NoSuchNode {
                    cell: CellId {
                        index,
                        tag: self.tags.cells.get(index).copied(),
                    },
                    node: tag,
                    nodes: self.points.len(),
                })?;
            }
            cells.push(nodes);
        }
        Ok(RawMesh {
            points_m: self.points,
            cells,
            regions: self.regions,
            region_names: self.region_names,
            tags: self.tags,
        })
    }
}

/// Names of gmsh's element types that fill a volume; `None` for points, lines and faces.
fn volume_type(kind: u64) -> Option<&'static str> {
    match kind {
        5 => Some("8-node hexahedron"),
        6 => Some("6-node prism"),
        7 => Some("5-node pyramid"),
        11 => Some("10-node tetrahedron"),
        12..=14 | 17..=19 => Some("second-order volume element"),
        29..=31 | 71..=75 | 79..=83 | 90..=93 => Some("high-order volume element"),
        _ => None,
    }
}

impl Lines<'_> {
    /// The head of a block: dimension, the entity's tag, which may be negative, and two more.
    fn block(&mut self, what: &str) -> Result<(i64, [u64; 3]), MeshError> {
        let line = self.next(what)?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let [dimension, tag, third, count] = words[..] else {
            return Err(self.expected(what, line));
        };
        let tag = tag.parse().map_err(|_| self.expected(what, line))?;
        let read = |word| self.integer(Some(word), line, what);
        Ok((tag, [read(dimension)?, read(third)?, read(count)?]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn a_file_cut_anywhere_is_refused_with_a_line() {
        let lines: Vec<&str> = FILE_41.lines().collect();
        for kept in 0..lines.len() {
            let text = lines[..kept].join("\n");
            let error = read_msh(&text, 1.0).expect_err("a part of a file");
            assert!(
                matches!(error, MeshError::Truncated { line, .. } if line == kept + 1)
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
            ("4.1 1 8", "binary"),
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
