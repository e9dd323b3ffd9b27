"""Where columns are recognised: what each column of a table holds, whoever wrote the table.

Two functions answer it, and no other module or domain does:

- `inspection.inspect` for columns of any names. It looks at the whole table: names, numbers, and the arm's kinematics.
  `init` writes its answer as a sidecar; two files are joined, and targets read, by it (`InspectedTable`).
- `documented.parse_columns` for documented names (`q1_rad`, `x_m`, `tau1_Nm`), also those that a sidecar gives. Every
  command that reads a recording comes here through `recordings.table.tabulate`.

Both speak of a `Column`: its name, quantity, joint and unit. Columns that are decided together are a `Block`, whose
`Decision` says the unit or the form, how sure it is, and why. What decides, in this order:

| module | decides |
|---|---|
| `column` | what a column may hold: the table `QUANTITIES` with units, arrays and usual words |
| `documented` | by a documented name, or what is wrong with it |
| `names`, `cells` | by words in names of people's own, and in cells: which blocks are possible |
| `sizes` | by the size of numbers: whether they can be what names say, and in which unit |
| `kinematics` | by an arm with which joints and poses agree: units and the form of rotations |
| `inspection` | of all that, for the table as a whole; what is left open is asked by `init` |

`orientations` makes quaternions of every documented form. Readers of logs need none of this: the type of a message says
what it holds, and they give its columns documented names.
"""
