//! Cell arrays that may have the regions of a mesh: which is taken, and what is said of the others.
//!
//! Entry points: [`RegionArrays::takes`] for each array of a file in turn, [`RegionArrays::end`].

use super::super::MeshError;

/// Names under which programs write the region of a cell: this one's, gmsh's, meshio's, pyvista's, VTK's.
const REGION_NAMES: [&str; 8] = [
    "region",
    "regions",
    "CellEntityIds",
    "gmsh:physical",
    "medit:ref",
    "material",
    "MaterialIds",
    "RegionId",
];

/// Names that come after those, without signs between letters: 3D Slicer's and Cleaver's, SfePy's, MFEM's, Exodus', meshio's
/// for formats of other programs, and the plain words.
const MORE_NAMES: [&str; 26] = [
    "label",
    "labels",
    "labelid",
    "mat",
    "matid",
    "matids",
    "materialid",
    "materials",
    "regionids",
    "attribute",
    "attributes",
    "subdomain",
    "subdomains",
    "subdomainid",
    "domainid",
    "blockid",
    "blockids",
    "elementblockids",
    "objectid",
    "tetgenref",
    "avsucdmaterial",
    "netgenindex",
    "flac3dgroup",
    "su2tag",
    "tissue",
    "tissueid",
];

/// A name without what writers put between its words.
fn plain(name: &str) -> String {
    let letters = name.chars().filter(|c| c.is_alphanumeric());
    letters.flat_map(char::to_lowercase).collect()
}

/// Head of a cell array.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head<'a> {
    pub name: &'a str,
    /// Numbers for each cell.
    pub width: u64,
    /// Whether its type is of whole numbers.
    pub is_whole: bool,
}

/// A cell array with a number for each cell.
#[derive(Debug)]
struct Known {
    name: String,
    /// Rank of the name among those that regions have: the least is the best; none for another.
    rank: Option<u8>,
    is_whole: bool,
    /// Whether it has numbers that are no regions.
    is_passed: bool,
}

/// Cell arrays of a file, as they come.
#[derive(Debug, Default)]
pub(super) struct RegionArrays {
    /// The name that the user gives.
    wanted: Option<String>,
    known: Vec<Known>,
    /// Names of arrays with several whole numbers for each cell.
    wide: Vec<String>,
}

impl RegionArrays {
    pub fn new(wanted: Option<&str>) -> Self {
        Self {
            wanted: wanted.map(str::to_owned),
            ..Self::default()
        }
    }

    /// Rank of a name among those that regions have; none for another.
    fn rank(&self, name: &str) -> Option<u8> {
        if let Some(wanted) = &self.wanted {
            return (wanted == name).then_some(0);
        }
        if REGION_NAMES.iter().any(|n| n.eq_ignore_ascii_case(name)) {
            return Some(0);
        }
        MORE_NAMES.contains(&plain(name).as_str()).then_some(1)
    }

    /// Whether the regions are those of this array, in place of one that came before; of equals the first.
    pub fn takes(&mut self, array: Head<'_>) -> bool {
        let is_known = self.known.iter().any(|known| known.name == array.name);
        if array.width != 1 {
            if array.is_whole && !self.wide.iter().any(|name| name == array.name) {
                self.wide.push(array.name.to_owned());
            }
            return false;
        }
        if is_known {
            return false;
        }
        self.known.push(Known {
            name: array.name.to_owned(),
            rank: self.rank(array.name),
            is_whole: array.is_whole,
            is_passed: false,
        });
        self.taken() == Some(array.name)
    }

    fn best(&self) -> Option<(u8, usize)> {
        let known = self.known.iter().enumerate();
        let ranked = known.filter(|(_, known)| !known.is_passed);
        ranked
            .filter_map(|(index, known)| Some((known.rank?, index)))
            .min()
    }

    /// The name of the array that has the regions.
    pub fn taken(&self) -> Option<&str> {
        self.best()
            .map(|(_, index)| self.known[index].name.as_str())
    }

    /// Whether the user names the array: then each of its numbers must be a region.
    pub fn is_named(&self) -> bool {
        self.wanted.is_some()
    }

    /// Passes over the array that is taken, as it has numbers that are no regions: the next best is taken.
    pub fn pass_over(&mut self) {
        if let Some((_, index)) = self.best() {
            self.known[index].is_passed = true;
        }
    }

    /// Notes about the arrays.
    ///
    /// # Errors
    /// [`MeshError::NoCellArray`], without the one that the user names.
    pub fn end(self) -> Result<Vec<String>, MeshError> {
        let taken = self.best();
        if let (Some(wanted), None) = (&self.wanted, taken) {
            let known: Vec<_> = self.known.into_iter().map(|known| known.name).collect();
            return Err(no_array(wanted, &known));
        }
        let note = |(
            index,
            Known {
                name,
                is_whole,
                is_passed,
                ..
            },
        ): (usize, &Known)| {
            match taken {
            Some((0, best)) if best == index => None,
            Some((_, best)) if best == index => {
                Some(format!("regions are those of the cell array `{name}`"))
            }
            _ if *is_passed => Some(format!(
                "the cell array `{name}` has the name of one of regions, and numbers that are not whole: it is passed over"
            )),
            _ => is_whole.then(|| format!(
                "the cell array `{name}` of whole numbers is not used: `--region {name}`, in a scene `region_array = \"{name}\"`, takes it for the regions"
            )),
        }
        };
        let wide = self.wide.iter().map(|name| {
            format!("the cell array `{name}` has several numbers for each cell: regions have one")
        });
        let notes = self.known.iter().enumerate().filter_map(note);
        Ok(notes.chain(wide).collect())
    }
}

/// The failure to find an array by its name among those that are known.
pub(super) fn no_array(wanted: &str, known: &[String]) -> MeshError {
    MeshError::NoCellArray {
        name: wanted.to_owned(),
        known: match known.is_empty() {
            true => "there is none with a number for each cell".to_owned(),
            false => format!(
                "with a number for each cell there are: {}",
                known.join(", ")
            ),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(wanted: Option<&str>, names: &[&str]) -> (Option<String>, Vec<String>) {
        let mut arrays = RegionArrays::new(wanted);
        for name in names {
            let head = Head {
                name,
                width: 1,
                is_whole: !name.ends_with("_f"),
            };
            arrays.takes(head);
        }
        let name = arrays.taken().map(str::to_owned);
        (name, arrays.end().expect("found"))
    }

    #[test]
    fn the_best_known_name_is_taken_and_others_are_told() {
        let (name, notes) = taken(
            None,
            &["labels", "temperature_f", "ids", "MAT_ID", "Region"],
        );
        assert_eq!(name.as_deref(), Some("Region"));
        let told: Vec<_> = notes.iter().map(|n| n.split('`').nth(1)).collect();
        assert_eq!(told, [Some("labels"), Some("ids"), Some("MAT_ID")]);
        assert!(notes[1].contains("--region ids"), "{notes:?}");
        for one in ["labels", "mat_id", "Subdomain-Id", "tetgen:ref"] {
            let (name, notes) = taken(None, &[one]);
            assert_eq!(name.as_deref(), Some(one));
            assert_eq!(notes.len(), 1, "a name that is guessed is told");
        }
        let mut wide = RegionArrays::new(None);
        for is_whole in [true, true, false] {
            let name = if is_whole { "labels" } else { "fibres" };
            wide.takes(Head {
                name,
                width: 3,
                is_whole,
            });
        }
        let notes = wide.end().expect("no name is wanted");
        assert!(
            notes.len() == 1 && notes[0].contains("`labels`"),
            "{notes:?}"
        );
        let (name, notes) = taken(Some("ids"), &["region", "ids"]);
        assert_eq!((name.as_deref(), notes.len()), (Some("ids"), 1));
        let mut none = RegionArrays::new(Some("ids"));
        none.takes(Head {
            name: "region",
            width: 1,
            is_whole: true,
        });
        let said = none.end().expect_err("no such array").to_string();
        assert!(
            said.contains("`ids`") && said.contains(": region"),
            "{said}"
        );
    }
}
