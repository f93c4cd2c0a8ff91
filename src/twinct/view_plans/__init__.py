"""Plans of views for a scenario: candidates that the arms reach, the patient, search, and trial."""
