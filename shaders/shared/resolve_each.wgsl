// Finds the pixels of a tile that show an element of a run of slots. The file that includes this says in `resolve` what each of them shows.
//!include shared/resolve

// Returns the number of the thread's pixels.
fn resolve_each(group: vec3<u32>, lane: u32, run: Run) -> u32 {
    var column = column_begin(group, lane);
    var resolved = 0u;
    resolve_load(&column, run.first_slot, run.count);
    loop {
        resolve_seek(&column, run.first_slot, run.count);
        if column_ends(column) {
            break;
        }
        if column.mine {
            resolve(column);
            resolved++;
        }
        resolve_next(&column, run.first_slot, run.count);
    }
    return resolved;
}
