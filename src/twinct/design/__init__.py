"""The workbench: a scenario's draft, answers about it, and the page that shows both."""
