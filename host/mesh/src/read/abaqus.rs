//! Reads abaqus `.inp` files, as CalculiX and gmsh write them too: nodes, tetrahedra and sets of elements.
//!
//! Entry point: [`read_abaqus`]. Format: Abaqus Keywords Guide, `*NODE`, `*ELEMENT`, `*ELSET`.

use super::super::{MeshError, RawMesh};
use super::gather::{Gather, Shape};
use super::scan::{Coding, Number, Scan};
use std::collections::{BTreeMap, HashMap};

/// Reads a file, in its own unit of length. Sets of elements are the regions, numbered from 1 in the order in which they
/// come; a cell in several belongs to the smallest, which says most, of equals to the later: programs name sets of their own before those of the user.
///
/// # Errors
/// A [`MeshError`] with the line of what cannot be read.
pub(super) fn read_abaqus(bytes: &[u8]) -> Result<RawMesh, MeshError> {
    let mut deck = Deck {
        file: Scan::new(bytes, Coding::Lines, None),
        gather: Gather::numbered(),
        cell_of: BTreeMap::new(),
        sets: Vec::new(),
        number_of: HashMap::new(),
    };
    let (mut has_nodes, mut has_elements) = (false, false);
    while let Some(line) = deck.next_line()? {
        let what = "a keyword such as *NODE";
        let Some(keyword) = line.strip_prefix('*') else {
            return Err(deck.file.expected(what, &line));
        };
        let mut parts = keyword.split(',').map(str::trim);
        let name = parts.next().unwrap_or("").to_ascii_uppercase();
        let options = parts.map(|part| match part.split_once('=') {
            Some((key, value)) => (
                key.trim().to_ascii_uppercase(),
                value.trim().trim_matches('"').to_owned(),
            ),
            None => (part.to_ascii_uppercase(), String::new()),
        });
        let options: HashMap<String, String> = options.collect();
        deck.file.next_line();
        match name.as_str() {
            "NODE" => {
                has_nodes = true;
                deck.nodes()?;
            }
            "ELEMENT" => {
                has_elements = true;
                let Some(kind) = options.get("TYPE") else {
                    return Err(deck
                        .file
                        .expected("*ELEMENT with a TYPE such as C3D4", &line));
                };
                deck.elements(kind, options.get("ELSET"))?;
            }
            "ELSET" => match options.get("ELSET") {
                Some(set) => deck.set(set, options.contains_key("GENERATE"))?,
                None => return Err(deck.file.expected("*ELSET with a name, ELSET=NAME", &line)),
            },
            "INCLUDE" => {
                let what = "all in one file: put what *INCLUDE names in its place";
                return Err(deck.file.expected(what, &line));
            }
            _ => while deck.data()?.is_some() {},
        }
    }
    if !has_nodes {
        return Err(MeshError::NoSection("*NODE"));
    }
    if !has_elements {
        return Err(MeshError::NoSection("*ELEMENT"));
    }
    deck.into_mesh()
}

/// Numbers of elements: from, to, in steps of.
type Range = [u64; 3];

struct Deck<'a> {
    file: Scan<'a>,
    gather: Gather,
    /// Index of each tetrahedron by its number.
    cell_of: BTreeMap<u64, usize>,
    /// Name and elements of each set.
    sets: Vec<(String, Vec<Range>)>,
    /// Its place among them, by its name in capitals.
    number_of: HashMap<String, usize>,
}

impl Deck<'_> {
    /// The current line if it is not blank, and no comment; it is not passed.
    fn next_line(&mut self) -> Result<Option<String>, MeshError> {
        while self.file.next_record() {
            let mut ahead = self.file.clone();
            let line = ahead.rest_of_line();
            if !line.starts_with(b"**") {
                let text = std::str::from_utf8(line);
                let text = text.map_err(|_| self.file.expected("text", ""))?;
                return Ok(Some(text.to_owned()));
            }
            self.file.next_line();
        }
        Ok(None)
    }

    /// The fields of the next line of data, unless a keyword comes.
    fn data(&mut self) -> Result<Option<String>, MeshError> {
        let line = self.next_line()?.filter(|line| !line.starts_with('*'));
        if line.is_some() {
            self.file.rest_of_line();
        }
        Ok(line)
    }

    fn number(&self, word: &str, line: &str, what: &str) -> Result<u64, MeshError> {
        let number = word.parse().ok();
        number.ok_or_else(|| self.file.expected(what, line))
    }

    fn nodes(&mut self) -> Result<(), MeshError> {
        let what = "a node: number, x, y, z";
        while let Some(line) = self.data()? {
            let mut words = fields(&line);
            let tag = self.number(words.next().unwrap_or(""), &line, what)?;
            let mut point = [0.0; 3];
            for x in &mut point {
                let number = words.next().and_then(Number::parse);
                *x = number
                    .ok_or_else(|| self.file.expected(what, &line))?
                    .real();
            }
            self.gather.node(self.file.place(), tag, point)?;
        }
        Ok(())
    }

    /// Elements of one type. Those with many nodes go on in the next line, after a comma.
    fn elements(&mut self, kind: &str, set: Option<&String>) -> Result<(), MeshError> {
        let shape = shape(kind);
        let what = "an element: number, nodes";
        let set = set.map(|name| self.set_index(name));
        let mut numbers = Vec::new();
        while let Some(line) = self.data()? {
            for word in fields(&line) {
                numbers.push(self.number(word, &line, what)?);
            }
            let wanted = match shape {
                Shape::Tetrahedron => 5,
                Shape::Tetrahedron10 => 11,
                _ => 0,
            };
            if line.ends_with(',') && numbers.len() < wanted {
                continue;
            }
            let Some((&tag, nodes)) = numbers.split_first() else {
                return Err(self.file.expected(what, &line));
            };
            let at = self.file.place();
            let index = self.gather.cells();
            self.gather.cell(at, tag, (shape, kind), 0, nodes)?;
            if self.gather.cells() > index && self.cell_of.insert(tag, index).is_some() {
                return Err(self.file.expected("another number for each element", &line));
            }
            if let Some((_, ranges)) = set.and_then(|set| self.sets.get_mut(set)) {
                ranges.push([tag, tag, 1]);
            }
            numbers.clear();
        }
        match numbers.is_empty() {
            true => Ok(()),
            false => Err(self.file.cut_off("more nodes of the element after a comma")),
        }
    }

    fn set_index(&mut self, name: &str) -> usize {
        let next = self.sets.len();
        let index = *self
            .number_of
            .entry(name.to_ascii_uppercase())
            .or_insert(next);
        if index == next {
            self.sets.push((name.to_owned(), Vec::new()));
        }
        index
    }

    /// Numbers of elements, ranges of them, or names of other sets.
    fn set(&mut self, name: &str, is_range: bool) -> Result<(), MeshError> {
        let index = self.set_index(name);
        while let Some(line) = self.data()? {
            let mut ranges = Vec::new();
            if is_range {
                let what = "from, to, step of numbers of elements";
                let mut words = fields(&line);
                let mut next = || words.next().map(|word| self.number(word, &line, what));
                let (Some(from), Some(to), step) = (next(), next(), next().unwrap_or(Ok(1))) else {
                    return Err(self.file.expected(what, &line));
                };
                ranges.push([from?, to?, step?.max(1)]);
            } else {
                for word in fields(&line) {
                    match self.number_of.get(&word.to_ascii_uppercase()) {
                        Some(&other) if other != index => {
                            let of = &self.sets[other].1;
                            ranges.extend(of.iter().copied());
                        }
                        Some(_) => {}
                        None => {
                            let tag = self.number(word, &line, "numbers of elements or a set")?;
                            ranges.push([tag, tag, 1]);
                        }
                    }
                }
            }
            let of = &mut self.sets[index].1;
            of.extend(ranges);
            // Sets of sets of sets must not grow beyond what there is.
            if of.len() > 2 * self.cell_of.len() + 1000 {
                of.sort_unstable();
                of.dedup();
            }
        }
        Ok(())
    }

    fn into_mesh(mut self) -> Result<RawMesh, MeshError> {
        let mut cells_of: Vec<Vec<usize>> = Vec::new();
        for (_, ranges) in &self.sets {
            let within = |[from, to, step]: &Range| {
                let range = *from..=(*to).max(*from);
                let (from, step) = (*from, *step);
                let cells = self.cell_of.range(range);
                cells.filter_map(move |(tag, cell)| ((tag - from) % step == 0).then_some(*cell))
            };
            let mut cells: Vec<usize> = ranges.iter().flat_map(within).collect();
            cells.sort_unstable();
            cells.dedup();
            cells_of.push(cells);
        }
        let mut order: Vec<usize> = (0..self.sets.len()).collect();
        // From the largest to the smallest; of equals the later is written last.
        order.sort_by_key(|set| std::cmp::Reverse(cells_of[*set].len()));
        for set in order {
            for &cell in &cells_of[set] {
                self.gather.regions[cell] = set as i64 + 1;
            }
            if !cells_of[set].is_empty() {
                let names = &mut self.gather.region_names;
                names.insert(set as i64 + 1, self.sets[set].0.clone());
            }
        }
        let used: std::collections::BTreeSet<i64> = self.gather.regions.iter().copied().collect();
        self.gather
            .region_names
            .retain(|region, _| used.contains(region));
        self.gather.into_mesh()
    }
}

/// What stands between commas.
fn fields(line: &str) -> impl Iterator<Item = &str> {
    let fields = line.split(',').map(str::trim);
    fields.filter(|field| !field.is_empty())
}

/// What a type of elements is: `C3D4` and `C3D10` with what follows are tetrahedra.
fn shape(kind: &str) -> Shape {
    let kind = kind.to_ascii_uppercase();
    let Some((_, nodes)) = kind.split_once("C3D").or(kind.split_once("COH3D")) else {
        return match kind.starts_with("SC") {
            true => Shape::Other("continuum shell"),
            false => Shape::Lower,
        };
    };
    let nodes: String = nodes.chars().take_while(char::is_ascii_digit).collect();
    match nodes.as_str() {
        "4" => Shape::Tetrahedron,
        "10" => Shape::Tetrahedron10,
        "8" | "20" | "27" => Shape::Other("hexahedron"),
        "6" | "15" => Shape::Other("prism"),
        "5" | "13" => Shape::Other("pyramid"),
        _ => Shape::Other("no tetrahedron"),
    }
}
