"""What a machine tool is and how errors move its tool tip."""
