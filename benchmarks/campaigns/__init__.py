"""What all trials share: sealing, processes, results that are kept, shares with intervals, tables, the command."""
