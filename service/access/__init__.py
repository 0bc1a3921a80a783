"""Who may call what: keys, roles, and the gate that every request comes through."""
